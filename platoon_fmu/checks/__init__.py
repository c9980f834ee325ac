"""Static and dynamic checks of any FMU; `validate` lists their findings."""
