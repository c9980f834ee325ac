"""Validated physics: standard manoeuvres driven with the FMU, held against linear models and closed forms."""
