"""All kinds of faults: those of a scenario, or injected into a running bench.

In TOML each is a table of `[[faults]]`: its kind, start (`at_s`), duration (`for_s`, until the end of the run if
omitted) and target. All random numbers of a fault follow from the scenario's seed.
"""

import inspect
from functools import cache
from typing import TYPE_CHECKING, Annotated, Union

from pydantic import ConfigDict, Field, TypeAdapter

from bench.faults import frames, nodes, processes, sensors, vehicles
from bench.faults.base import Fault

FAMILIES = (frames, sensors, nodes, processes, vehicles)
"""The modules with kinds of faults: each class in them that has a `kind`."""


@cache
def kinds() -> dict[str, type[Fault]]:
    """Return the class of each kind of fault by name."""
    classes = [each for family in FAMILIES for each in vars(family).values() if inspect.isclass(each)]
    return {each.name(): each for each in classes if issubclass(each, Fault) and "kind" in each.model_fields}


if TYPE_CHECKING:
    AnyFault = Fault
else:
    # As pydantic reads it: the table's `kind` selects the class.
    AnyFault = Annotated[Union[tuple(kinds().values())], Field(discriminator="kind")]  # noqa: UP007 - not known before

# Built when it is needed: most runs have no fault.
ONE_FAULT: TypeAdapter[Fault] = TypeAdapter(AnyFault, config=ConfigDict(defer_build=True))
"""Validates one fault of any kind."""
