"""How much a test tries: enough to fail where something is wrong, and with `--full` what can be waited for once."""

_full = [False]


def choose(*, full: bool) -> None:
    _full[0] = full


def effort(few: int, many: int) -> int:
    return many if _full[0] else few
