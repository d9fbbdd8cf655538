"""The wire protocol: the messages of the Open Inference Protocol v2 on zenoh keys, packed with msgpack.

Keys, below a prefix (`taxel` unless configured):

    <prefix>/v2                                      server metadata
    <prefix>/v2/health/live, /v2/health/ready        is it up; is it ready to predict
    <prefix>/v2/models/<name>[/versions/<v>]         model metadata
    …/ready, …/infer, …/stats                        of one model
    <prefix>/v2/cancel                               a request is given up
    <prefix>/v2/repository/index                     every model and its state
    <prefix>/@replica/<id>                           a liveliness token: this server is there

An error is a zenoh error reply, `{"error": text, "code": one of taxel.errors.Code}`.
Everything below is the hot path: it checks by hand and copies nothing.
"""

from typing import Any, Final, NamedTuple, TypeGuard

import msgpack
import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.errors import Internal, InvalidArgument, RequestError, ResourceExhausted, from_code
from taxel.manifest import INPUT_NAME, OUTPUT_NAME, SPREAD_NAME
from taxel.trace_context import is_traceparent

PREFIX: Final = "taxel"
REPLICAS: Final = "@replica"
"""Below a prefix, where each server has keys of its own. No wildcard matches a part that begins with @."""

MAX_ROWS: Final = 65_536
"""The most windows in one request; a server may allow fewer."""

CANCEL: Final = "cancel"
"""What servers call it, where they tell what they can, that a request can be given up."""

CANCEL_PATH: Final = "v2/cancel"
"""The path of a query that gives a request up; it has the `source_info` of that request."""

_MAX_PARTS: Final = 64
"""The most lists and maps in one request, and the most entries in each."""

_FLOAT: Final = np.dtype("<f4")


def model_path(name: str, version: str | None, action: str = "") -> str:
    """The path of a model, or of an `action` on it such as `infer`: its key without the prefix."""
    where = f"/versions/{version}" if version else ""
    return f"v2/models/{name}{where}{'/' + action if action else ''}"


def model_key(prefix: str, name: str, version: str | None, action: str = "") -> str:
    """The key of a model, or of an `action` on it such as `infer`."""
    return f"{prefix}/{model_path(name, version, action)}"


class InferRequest(NamedTuple):
    """A decoded request: windows (n, f) float32, whether it asks for the spread, the W3C's traceparent."""

    windows: NDArray[np.float32]
    id: str | None = None
    timeout_ms: float | None = None
    spread: bool = False
    traceparent: str | None = None


class InferResponse(NamedTuple):
    """A decoded reply: counts (n, 21) float32, and how long the server took.

    `spread` is (n, 21), too, if the request asked for it.
    """

    outputs: NDArray[np.float32]
    model_name: str
    model_version: str
    id: str | None
    queue_us: int
    compute_us: int
    batch_rows: int
    spread: NDArray[np.float32] | None = None


def pack_infer_request(
    windows: NDArray[np.float32],
    *,
    request_id: str | None = None,
    timeout_ms: float | None = None,
    spread: bool = False,
    traceparent: str | None = None,
) -> bytes:
    """Encode windows, (n, f) float32 C-contiguous, as an infer request."""
    data = windows.astype(_FLOAT, copy=False).data
    tensor = {"name": INPUT_NAME, "datatype": "FP32", "shape": windows.shape, "data": data}
    request: dict[str, Any] = {"inputs": [tensor]}
    if spread:
        request["outputs"] = [{"name": OUTPUT_NAME}, {"name": SPREAD_NAME}]
    if request_id is not None:
        request["id"] = request_id
    parameters = {"timeout_ms": timeout_ms, "traceparent": traceparent}
    if given := {name: value for name, value in parameters.items() if value is not None}:
        request["parameters"] = given
    return packb(request)


def unpack_infer_request(payload: bytes, max_rows: int = MAX_ROWS) -> InferRequest:
    """Decode an infer request; the windows are a read-only view of its bytes.

    It does not check the number of features, or that the values are finite.

    Raises:
        InvalidArgument: the bytes are no request; the text names the field.
        ResourceExhausted: more than `max_rows` windows.
    """
    request = _mapping(_unpack_frugally(payload), "request")
    request_id = request.get("id")
    if request_id is not None and not isinstance(request_id, str):
        raise InvalidArgument(f"id: {_kind(request_id)}: expected text")
    inputs = request.get("inputs")
    if not isinstance(inputs, list) or len(inputs) != 1:
        raise InvalidArgument(f"inputs: {_kind(inputs)}: expected a list of one tensor, {INPUT_NAME!r}")
    windows = _tensor(_mapping(inputs[0], "inputs[0]"), "inputs[0]", INPUT_NAME, max_rows)
    parameters = request.get("parameters")
    given = {} if parameters is None else _mapping(parameters, "parameters")
    timeout, traceparent = given.get("timeout_ms"), given.get("traceparent")
    return InferRequest(
        windows,
        request_id,
        None if timeout is None else checked_timeout_ms(timeout),
        _asks_for_spread(request.get("outputs")),
        traceparent if is_traceparent(traceparent) else None,
    )


def _asks_for_spread(outputs: object) -> bool:
    """Whether a request's `outputs` name the spread as well."""
    if outputs is None:
        return False
    names = [output.get("name") for output in outputs] if _are_maps(outputs) else None
    if names not in ([OUTPUT_NAME], [OUTPUT_NAME, SPREAD_NAME]):
        expected = f"[{OUTPUT_NAME!r}] or [{OUTPUT_NAME!r}, {SPREAD_NAME!r}]"
        raise InvalidArgument(f"outputs: {_short(names or outputs)}: expected the names {expected}")
    return len(names) > 1


def _are_maps(values: object) -> TypeGuard[list[dict[str, Any]]]:
    return isinstance(values, list) and all(isinstance(value, dict) for value in values)


def checked_timeout_ms(timeout: object) -> float:
    """A request's `timeout_ms`.

    Raises:
        InvalidArgument: it is not a number above 0 and below 1e9.
    """
    if isinstance(timeout, bool) or not isinstance(timeout, (int, float)) or not 0 < timeout < 1e9:
        raise InvalidArgument(
            f"parameters.timeout_ms: {timeout!r}: expected milliseconds above 0 and below 1e9"
        )
    return float(timeout)


def _tensor(tensor: dict[str, Any], where: str, name: str, max_rows: int) -> NDArray[np.float32]:
    if tensor.get("name") != name:
        raise InvalidArgument(f"{where}.name: {_short(tensor.get('name'))}: expected {name!r}")
    if tensor.get("datatype") != "FP32":
        raise InvalidArgument(f"{where}.datatype: {_short(tensor.get('datatype'))}: expected 'FP32'")
    shape = tensor.get("shape")
    if not isinstance(shape, list) or len(shape) != 2:
        raise InvalidArgument(f"{where}.shape: {_short(shape)}: expected [n, f], two whole numbers")
    rows, columns = shape
    if type(rows) is not int or type(columns) is not int:
        raise InvalidArgument(f"{where}.shape: {_short(shape)}: expected [n, f], two whole numbers")
    if rows < 1 or columns < 1:
        raise InvalidArgument(f"{where}.shape: {shape}: expected at least one row and one column")
    if rows > max_rows:
        raise ResourceExhausted(f"{where}.shape: {rows} rows: expected at most {max_rows} in one request")
    data = tensor.get("data")
    if not isinstance(data, bytes):
        raise InvalidArgument(f"{where}.data: {_kind(data)}: expected bytes, little-endian float32")
    if len(data) != rows * columns * _FLOAT.itemsize:
        expected = rows * columns * _FLOAT.itemsize
        raise InvalidArgument(f"{where}.data: {len(data)} bytes: expected {expected} for shape {shape}")
    return np.frombuffer(data, _FLOAT).reshape(rows, columns)


def pack_infer_response(response: InferResponse) -> bytes:
    """Encode predictions."""
    outputs = [_packed(OUTPUT_NAME, response.outputs)]
    if response.spread is not None:
        outputs.append(_packed(SPREAD_NAME, response.spread))
    reply: dict[str, Any] = {
        "model_name": response.model_name,
        "model_version": response.model_version,
        "outputs": outputs,
        "parameters": {
            "queue_us": response.queue_us,
            "compute_us": response.compute_us,
            "batch_rows": response.batch_rows,
        },
    }
    if response.id is not None:
        reply["id"] = response.id
    return packb(reply)


def _packed(name: str, values: NDArray[np.float32]) -> dict[str, Any]:
    data = np.ascontiguousarray(values, _FLOAT).data
    return {"name": name, "datatype": "FP32", "shape": values.shape, "data": data}


def unpack_infer_response(payload: bytes) -> InferResponse:
    """Decode predictions.

    Raises:
        Internal: the reply is not one that a Taxel server sends.
    """
    try:
        reply = _mapping(unpackb(payload), "reply")
        first, *more = reply["outputs"]
        times = reply["parameters"]
        return InferResponse(
            _channels(first, OUTPUT_NAME),
            reply["model_name"],
            reply["model_version"],
            reply.get("id"),
            times["queue_us"],
            times["compute_us"],
            times["batch_rows"],
            _channels(more[0], SPREAD_NAME) if more else None,
        )
    except (RequestError, KeyError, TypeError, ValueError) as error:
        raise Internal(f"the server's reply is malformed: {error!r}") from None


def _channels(tensor: object, name: str) -> NDArray[np.float32]:
    values = _tensor(_mapping(tensor, name), name, name, 2**31)
    if values.shape[1] != len(CHANNELS):
        raise InvalidArgument(f"{name}.shape: {values.shape}: expected (n, {len(CHANNELS)})")
    # The caller may change them, as those of a model in its own process.
    return values.copy()


def pack_error(error: RequestError) -> bytes:
    """Encode an error reply."""
    reply: dict[str, str | int] = {"error": str(error), "code": error.code}
    if isinstance(error, ResourceExhausted) and error.open_requests is not None:
        reply["open"] = error.open_requests
    return packb(reply)


def unpack_error(payload: bytes) -> RequestError:
    """The error in an error reply; `Internal` if the reply is not one of ours."""
    try:
        reply = _mapping(unpackb(payload), "error")
        error = from_code(str(reply["code"]), str(reply["error"]))
        if isinstance(error, ResourceExhausted) and type(reply.get("open")) is int:
            error.open_requests = max(reply["open"], 0)
        return error
    except (InvalidArgument, KeyError):
        return Internal(f"the server answered with an error that is not Taxel's: {payload[:80]!r}")


def packb(value: Any) -> bytes:
    """Encode any metadata."""
    packed: bytes = msgpack.packb(value, use_bin_type=True)
    return packed


def unpackb(payload: bytes, **limits: Any) -> Any:
    """Decode any metadata; `limits` are msgpack's own.

    Raises:
        InvalidArgument: the bytes are not msgpack.
    """
    try:
        return msgpack.unpackb(payload, raw=False, strict_map_key=True, **limits)
    except (ValueError, msgpack.UnpackException) as error:
        reason = str(error) or type(error).__name__
        raise InvalidArgument(f"payload: {len(payload)} bytes that are not msgpack: {reason}") from None


def _unpack_frugally(payload: bytes) -> Any:
    """Decode untrusted bytes: a large message must not become millions of objects."""
    parts = 0

    def count(part: Any) -> Any:
        nonlocal parts
        parts += 1
        if parts > _MAX_PARTS:
            raise ValueError(f"more than {_MAX_PARTS} lists and maps")
        return part

    return unpackb(
        payload, object_hook=count, list_hook=count, max_array_len=_MAX_PARTS, max_map_len=_MAX_PARTS
    )


def _mapping(value: object, where: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise InvalidArgument(f"{where}: {_kind(value)}: expected a map")
    return value


def _kind(value: object) -> str:
    return "missing" if value is None else f"a {type(value).__name__}"


def _short(value: object) -> str:
    text = repr(value)
    return "missing" if value is None else text if len(text) <= 60 else text[:57] + "…"
