"""What all our ONNX files share: pinned versions, and no content but the model."""

from typing import Final

import onnx

OPSET: Final = 20
IR_VERSION: Final = 10


def plain(model: onnx.ModelProto) -> onnx.ModelProto:
    """A model without the exporter's notes, which name files of the exporting machine."""
    model.ir_version = IR_VERSION
    model.producer_name, model.producer_version = "taxel", ""
    del model.metadata_props[:]
    graph = model.graph
    graph.doc_string = ""
    for part in (graph, *graph.node, *graph.input, *graph.output, *graph.value_info, *graph.initializer):
        del part.metadata_props[:]
        part.doc_string = ""
    del graph.value_info[:]
    onnx.checker.check_model(model)
    return model
