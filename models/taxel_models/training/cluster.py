"""A Dask cluster to compute on."""

from typing import Any

from distributed import CancelledError, Client, Future, KilledWorker

from taxel.errors import SettingsError, Unavailable


def connect(address: str, patience_s: float = 20.0) -> Client:
    """A client of a scheduler, such as `tcp://10.0.0.1:8786`.

    Args:
        patience_s: how long to wait for the scheduler.

    Raises:
        Unavailable: no scheduler answers, or it has no workers.
        SettingsError: a worker runs several tasks at once.
    """
    try:
        client = Client(address, timeout=patience_s, set_as_default=False)
    except (OSError, ValueError) as error:
        raise Unavailable(f"no Dask scheduler answers at {address}: {error}") from None
    threads: dict[str, int] = client.nthreads()
    # Torch's random state belongs to a process: a second task in it would change the results.
    several = [worker for worker, number in threads.items() if number > 1]
    if several or not threads:
        client.close()
        if not threads:
            raise Unavailable(f"the Dask scheduler at {address} has no workers")
        raise SettingsError(
            f"worker {several[0]} runs {threads[several[0]]} tasks at once: "
            "start workers with `dask worker --nworkers N --nthreads 1`"
        )
    return client


def result_of(future: Future, name: str) -> Any:
    """What a task came to; `name` is that of the task.

    Raises:
        Unavailable: its worker or the scheduler is gone for good.
    """
    try:
        return future.result()
    except (KilledWorker, CancelledError) as error:
        raise Unavailable(f"{name}: its worker or the scheduler is gone ({error}); run again") from None
