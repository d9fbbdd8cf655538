"""Networks: few windows by a program that is compiled from the ONNX file, more by ONNX Runtime."""

from taxel_server.runtimes.networks.runtime import NetworkRuntime, open_artifact

__all__ = ["NetworkRuntime", "open_artifact"]
