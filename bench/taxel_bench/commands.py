"""The `bench` command."""

from taxel.commands.cli import failing_clearly, new_app
from taxel_bench.capacity.command import capacity
from taxel_bench.chaos.command import chaos
from taxel_bench.choice.command import choice
from taxel_bench.churn.command import churn
from taxel_bench.compare.command import compare
from taxel_bench.forms.command import forms
from taxel_bench.lane.command import lane
from taxel_bench.load.command import load
from taxel_bench.planted.command import planted
from taxel_bench.reload.command import reload
from taxel_bench.replicas.command import replicas
from taxel_bench.report.command import report
from taxel_bench.run.command import run
from taxel_bench.scale.command import scale
from taxel_bench.simulator.command import simulator
from taxel_bench.soak.command import soak
from taxel_bench.table.command import table

app = new_app("Measure Taxel's models and server.")

for command in (
    *(run, table, choice, forms, report),
    *(load, compare, lane, capacity, scale, simulator),
    *(churn, reload, replicas, chaos, soak),
    planted,
):
    app.command(command.__name__)(failing_clearly(command))


def main() -> None:
    """Entry point of the `bench` command."""
    app()
