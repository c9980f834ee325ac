"""Usage errors in plain words."""


def usage_problem(error: BaseException) -> str | None:
    """Return what is wrong with an option's value in plain words; None if the error says so itself."""
    details = getattr(error.__cause__, "errors", None)
    if details is None:
        return None
    detail = details()[0]
    if detail["type"] == "value_error":
        return str(detail["ctx"]["error"])
    return f"{detail['msg'].partition(',')[0]}, not {detail['input']!r}"
