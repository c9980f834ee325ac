"""`python -m bench.cli`: the same as `platoon`."""

from bench.cli.main import main

main()
