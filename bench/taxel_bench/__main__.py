"""`python -m taxel_bench`: the `bench` command, for where its script is not on the path."""

from taxel_bench.commands import main

main()
