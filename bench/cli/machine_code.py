"""Commands that run the bench do so as machine code: what is not compiled is compiled, and the command starts again."""

import typer

from bench.cli.fmu import say_first_use
from bench.cli.output import message
from bench.compiled.finder import INTERPRETED, is_compiled, is_wanted

SLOWER = "some fifty times as slow"
"""How interpreted modules compare with compiled ones."""


def use_machine_code() -> None:
    """Compile the hot modules if there is no machine code of their present sources, and start this command again.

    An edited file and the first run of an installed package need it. This process has loaded the sources, and can only
    go on with them: so it does on request (`PLATOON_INTERPRETED`), and says so.

    Raises:
        BadInput: they cannot be compiled; the message says how to mend it, and how to do without.
    """
    if is_compiled():
        return
    if not is_wanted():
        typer.echo(message(f"{INTERPRETED} is set: the bench is interpreted, {SLOWER}"), err=True)
        return
    # Imported here, because hardly any command needs them.
    from bench.compiled.build import compile_modules
    from bench.errors import BadInput
    from platoon_fmu.interpreter import restart

    try:
        compile_modules(say_first_use)
    except BadInput as error:
        raise BadInput(f"{error}\nOr run the bench interpreted, {SLOWER}: {INTERPRETED}=1") from error
    restart()
