"""`taxel predict`: predict a recording, on a server or in this process."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray
from rich.progress import track

from taxel.atomic import check_file_place, check_folder_place
from taxel.channels import CHANNELS
from taxel.commands.cli import ERR, OUT, Json, print_json
from taxel.commands.models import Connect, Repository, open_source
from taxel.dependencies import require
from taxel.errors import RecordingError, SettingsError
from taxel.predictor import Predictor
from taxel.trained_contacts import TrainedContacts
from taxel.windows import Samples, build_windows
from taxel.windows.history import TICK_S
from taxel_models.model import ROWS_A_REQUEST


def predict(
    recording: Annotated[
        Path, typer.Argument(help="A recording, a CSV file or a folder; or a CSV file of contacts alone.")
    ],
    model: Annotated[
        str, typer.Option(metavar="NAME[/VERSION]", help="The model; newest version if none.")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="CSV file to write.")],
    connect: Connect = None,
    repository: Repository = None,
    report: Annotated[
        Path | None, typer.Option(help="Folder to write figures, a table and plots of the errors to.")
    ] = None,
    timeout: Annotated[float, typer.Option(help="Seconds to wait for each answer.")] = 30.0,
    strict: Annotated[
        bool, typer.Option("--strict", help="Fail if the recording looks wrong, beside the training's.")
    ] = False,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="A Dask scheduler whose workers predict, as tcp://HOST:8786."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Predict the channels of a recording and compare them with what was measured.

    Without `--connect` and `--repository`, a model that comes with Taxel predicts.

    `--json` prints mae, norm_mae, mae_electrodes, norm_mae_electrodes, rows, and still: channels that
    hardly move; for a recording without measured channels, rows alone.
    """
    from taxel_models.evaluation import FIGURES
    from taxel_models.evaluation.predictions import write_predictions

    check_file_place(output, reads=recording)
    if report is not None:
        require("--report", "plot", "jinja2", "matplotlib")
        check_folder_place(report, replacing=FIGURES)
    if scheduler is not None:
        require("--scheduler", "study", "dask", "distributed")
    name, _, version = model.partition("/")
    with open_source(connect, repository) as source:
        predictor = source.predictor(name, version or None)
        trained = predictor.manifest.trained_contacts
        samples, channels, given = _read(recording, trained, strict=strict)
        if report is not None and channels is None:
            raise SettingsError(f"--report: {recording} has no measured channels to compare with")
        windows = build_windows(samples, predictor.window, predictor.manifest.window.extras, given)
        if not len(windows):
            ticks = predictor.window.look_back + predictor.window.look_ahead + 1
            raise RecordingError(
                f"{recording} holds no whole window: expected segments of at least {ticks} ticks, "
                f"{ticks * TICK_S:.2g} s"
            )
        if scheduler is None:
            parts = _predict_here(predictor, windows.values, timeout)
        else:
            parts = _predict_there(scheduler, connect, repository, predictor, windows.values, timeout)
        predicted = _watched(parts, len(windows))
    time_ns = samples.time_ns[windows.rows]
    write_predictions(time_ns, predicted, output)
    if channels is None:
        if as_json:
            print_json({"rows": len(windows)})
    else:
        measured = channels[windows.rows]
        _compare(predictor, recording.name, time_ns, measured, predicted, report, as_json)
    if not as_json:
        OUT.print(f"{len(windows)} windows. Wrote {output}.", soft_wrap=True)


def _read(
    path: Path, trained: TrainedContacts | None, *, strict: bool
) -> tuple[Samples, NDArray[np.float64] | None, Mapping[str, NDArray[np.float64]]]:
    """The ticks of a recording, its measured channels if it has any, and its other columns."""
    from taxel_models.recordings import has_channels, read_contacts, read_recording

    if path.is_file() and not has_channels(path):
        return read_contacts(path).ticks(), None, {}
    ticks = read_recording(path, trained=trained, strict=strict).ticks()
    return ticks.samples, ticks.channels, {**ticks.auxiliary, **ticks.covariates}


def _predict_here(
    predictor: Predictor, windows: NDArray[np.float32], timeout: float
) -> Iterator[NDArray[np.float32]]:
    for start in range(0, len(windows), ROWS_A_REQUEST):
        yield predictor.predict(windows[start : start + ROWS_A_REQUEST], timeout=timeout)


def _predict_there(
    scheduler: str,
    connect: str | None,
    repository: Path | None,
    predictor: Predictor,
    windows: NDArray[np.float32],
    timeout: float,
) -> Iterator[NDArray[np.float32]]:
    """The same by a cluster's workers, which open the same version of the model."""
    from taxel_models.commands.predict_on_cluster import PredictionTask, predictions_of_workers

    manifest = predictor.manifest
    folder = None if repository is None else repository.resolve()
    task = PredictionTask(
        connect, folder, manifest.name, manifest.version, manifest.model_file.sha256, timeout
    )
    return predictions_of_workers(scheduler, task, windows)


def _watched(parts: Iterator[NDArray[np.float32]], rows: int) -> NDArray[np.float32]:
    """All parts as one array, with a progress bar on a terminal."""
    total = -(-rows // ROWS_A_REQUEST)
    watched = track(parts, "predicting", total, console=ERR, disable=not ERR.is_terminal)
    return np.concatenate([np.empty((0, len(CHANNELS)), np.float32), *watched])


def _compare(
    predictor: Predictor,
    recording: str,
    time_ns: NDArray[np.int64],
    measured: NDArray[np.float64],
    predicted: NDArray[np.float32],
    report: Path | None,
    as_json: bool,
) -> None:
    from taxel_models.evaluation.error_table import error_table
    from taxel_models.evaluation.metrics import ErrorMetrics

    normalisation = predictor.manifest.normalisation
    errors = ErrorMetrics.of(measured, predicted, normalisation.output_std)
    if report is not None:
        from taxel_models.evaluation.evaluation_report import write_report

        write_report(
            report,
            about={
                "model": predictor.manifest.label,
                "inputs": f"input combination {predictor.window.combination}",
                "recording": recording,
            },
            time_ns=time_ns,
            measured=measured,
            predicted=predicted,
            normalisation=normalisation,
        )
    if as_json:
        print_json({**errors.summary(), "still": list(errors.still)})
    else:
        OUT.print(error_table(errors))
