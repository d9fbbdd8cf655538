"""`python -m taxel`: the `taxel` command, for where its script is not on the path."""

from taxel.commands.cli import main

main()
