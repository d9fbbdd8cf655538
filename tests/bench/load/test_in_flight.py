import numpy as np

from taxel.channels import CHANNELS
from taxel.errors import ResourceExhausted, Unavailable
from taxel.protocol import InferResponse, pack_infer_response
from taxel_bench.load.in_flight import QueriesInFlight


def answer(rows: int) -> bytes:
    outputs = np.zeros((rows, len(CHANNELS)), np.float32)
    return pack_infer_response(InferResponse(outputs, "xgb", "1", None, 30, 20, rows))


def test_every_query_that_was_sent_has_one_record() -> None:
    """Answered out of order, refused, answered wrongly, never answered; one was never sent."""
    in_flight = QueriesInFlight(queries=5, samples=2, start=0.0)
    back = [in_flight.depart(due) for due in (1.0, 2.0, 3.0, 4.0)]
    back[1](ResourceExhausted("full"))
    back[0](answer(2))
    back[2](answer(1))
    assert not in_flight.server_gone
    records = in_flight.land(patience_s=0.05)
    assert records["code"].tolist() == ["", "RESOURCE_EXHAUSTED", "INTERNAL", "DEADLINE_EXCEEDED"]
    assert records["scheduled"].tolist() == [1.0, 2.0, 3.0, 4.0]
    assert records[0][["queue_us", "compute_us"]].tolist() == (30, 20)
    assert (records["answered"][:3] >= records["sent"][:3]).all()


def test_a_server_that_has_gone_is_noticed() -> None:
    in_flight = QueriesInFlight(queries=2, samples=1, start=0.0)
    in_flight.depart(0.0)(Unavailable("nobody answers"))
    assert in_flight.server_gone
    assert in_flight.land(0.05)["code"].tolist() == ["UNAVAILABLE"]
