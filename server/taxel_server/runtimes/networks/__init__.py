"""Networks for single windows: an ONNX file compiled into steps, beside ONNX Runtime for larger batches."""

from taxel_server.runtimes.networks.runtime import NetworkRuntime, compiled_network

__all__ = ["NetworkRuntime", "compiled_network"]
