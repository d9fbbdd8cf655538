"""Opens the source that a command line names."""

from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Final, NamedTuple

from taxel.errors import SettingsError
from taxel_watch.scene import Source

_DEMO_MODEL: Final = "xgb"


class Wanted(NamedTuple):
    """What a command line asks for.

    Attributes:
        recordings: to replay, one a fingertip.
        demo: whether to show the twin instead.
        model: that predicts them; None for none, or for the demo's.
        corrected: the corrected version beside it, if any.
        connect: the server that predicts; or that is watched, without recordings and demo.
        repository: where models are; None for those that come with Taxel.
    """

    recordings: tuple[Path, ...] = ()
    demo: bool = False
    model: str | None = None
    corrected: str | None = None
    connect: str | None = None
    repository: Path | None = None


@contextmanager
def opened(wanted: Wanted, *, whole: bool = False) -> Iterator[Source]:
    """The source that a command line names.

    Args:
        whole: wait until all is predicted.

    Raises:
        SettingsError: it names none, or several.
        RecordingError: a recording does not exist, or is damaged.
        RequestError: a server does not answer, or may not be watched; if `whole`, there is no such model.
    """
    chosen = [wanted.demo, bool(wanted.recordings)].count(True)
    if chosen > 1 or (not chosen and wanted.connect is None):
        raise SettingsError("expected one of: RECORDING …, --demo, or --connect ENDPOINT alone")
    if wanted.corrected is not None and wanted.model is None:
        raise SettingsError("--corrected: expected --model as well, the version that it corrects")
    with ExitStack() as stack:
        if not chosen:
            yield stack.enter_context(_live(wanted))
            return
        from taxel_watch.demo import demo
        from taxel_watch.files import replay_of
        from taxel_watch.prediction import Asked, Predicting

        replay = demo() if wanted.demo else replay_of(wanted.recordings)
        model = wanted.model or (_DEMO_MODEL if wanted.demo else None)
        if model is not None:
            asked = Asked(model, wanted.corrected, wanted.connect, wanted.repository)
            predicting = stack.enter_context(closing(Predicting(replay, asked)))
            if whole:
                predicting.wait()
        yield replay


@contextmanager
def _live(wanted: Wanted) -> Iterator[Source]:
    import taxel
    from taxel_watch.live import Live

    if wanted.model is not None:
        raise SettingsError(
            "--model: expected recordings to predict; a server is watched as its clients ask"
        )
    with taxel.connect(wanted.connect) as server, closing(Live(server)) as live:
        yield live
