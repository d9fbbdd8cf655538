"""Neural networks, in torch: architectures of the paper and of Ruppel et al., and how they are trained."""
