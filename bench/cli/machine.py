"""What this machine can do: `platoon doctor`, and `platoon vcan`, which provides CAN links if the kernel has none."""

from typing import Annotated

import typer

from bench.cli.options import LOGS
from bench.cli.output import shown


def add_machine(app: typer.Typer) -> None:
    """Add the commands to the app."""
    app.command(
        epilog="Exit code: the command's own, 128 + n where signal n ended it; 2 if CAN cannot be provided.",
        context_settings={"ignore_unknown_options": True, "allow_interspersed_args": False},
    )(vcan)
    app.command()(doctor)


def vcan(
    command: Annotated[list[str], typer.Argument(metavar="COMMAND", help="Any command with its arguments.")],
    memory: Annotated[int, typer.Option(metavar="MB", help="Memory limit of the small kernel.")] = 2048,
) -> None:
    """Run a command with the CAN links vcan0 to vcan16, even if this machine's kernel has no CAN.

    If this kernel has the links, or lets you create them, the command runs here, and the links stay. Otherwise it runs
    in user-mode Linux, a kernel that is an ordinary program: one core, this machine's files, your permissions. There,
    processes that the command leaves running end with it.

    Example:
      platoon vcan -- platoon run formation --can vcan
    """
    from bench.vcan.run import run_command

    raise typer.Exit(run_command(command, memory))


def doctor() -> None:
    """Report what this machine can do and how to install what is missing. Exit code 1 if no run would work."""
    from rich.text import Text

    from bench.cli.doctor import examine
    from bench.cli.terminal import Terminal

    terminal, can_run = Terminal(), True
    for finding in examine(LOGS):
        mark = Text("ok     ", "green") if finding.fine else Text("missing", "yellow")
        terminal.print(mark.append(shown(f"  {finding.subject:14}  {finding.found}"), "default"), soft_wrap=True)
        if not finding.fine:
            for line in finding.mend.splitlines():
                typer.echo(f"{'':25}> {line.strip()}")
        can_run &= finding.fine or not finding.needed
    raise typer.Exit(0 if can_run else 1)
