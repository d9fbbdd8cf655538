"""The `bench` command."""

from taxel.commands.cli import failing_clearly, new_app
from taxel_bench.chaos.command import chaos
from taxel_bench.churn.command import churn
from taxel_bench.compare.command import compare
from taxel_bench.forms.command import forms
from taxel_bench.lane.command import lane
from taxel_bench.load.command import load
from taxel_bench.report.command import report
from taxel_bench.run.command import run
from taxel_bench.table.command import table

app = new_app("Measure Taxel's models and server.")

for command in (run, table, load, compare, churn, chaos, lane, forms, report):
    app.command(command.__name__)(failing_clearly(command))


def main() -> None:
    """Entry point of the `bench` command."""
    app()
