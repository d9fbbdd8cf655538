"""The errors of predictions as a table for the terminal."""

from rich.table import Table

from taxel.channels import CHANNELS
from taxel_models.evaluation.metrics import ErrorMetrics


def error_table(errors: ErrorMetrics) -> Table:
    """One row for each channel, and whether it hardly moves; then the paper's two averages."""
    table = Table("channel", "MAE, counts", "norm. MAE")
    for column in table.columns[1:]:
        column.justify = "right"
    table.add_column("")
    rows = zip(CHANNELS, errors.channel_mae, errors.channel_norm_mae, strict=True)
    for name, mae, norm_mae in rows:
        note = "hardly moves" if name in errors.still else ""
        table.add_row(name, f"{mae:.2f}", f"{norm_mae:.3f}", note)
    table.add_section()
    table.add_row("all 21", f"{errors.mae:.2f}", f"{errors.norm_mae:.3f}")
    table.add_row("electrodes", f"{errors.mae_electrodes:.2f}", f"{errors.norm_mae_electrodes:.3f}")
    return table
