"""Another revision of this repository against this one: `python -m bench.benchmarks against REV`.

`checkout` builds the other revision in a folder of its own; `run_cost` runs the `platoon` command of either from
outside and takes what kernel and log say, `profile` what a sampling profiler says; `comparison` runs both in turn;
`tables` sets out the ratios. Nothing of the other revision is imported here, so it may differ in everything but the
command line of `platoon run` and the log.
"""
