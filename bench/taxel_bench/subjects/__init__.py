"""What is measured: a model with our runtime, and the engines that it is compared with."""
