"""Import of networks that were trained for the Gazebo BioTac plugin, from their `model.yaml`."""
