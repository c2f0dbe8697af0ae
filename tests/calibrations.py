"""Calibrations with other members, for tests."""

from boresight.calibration.calibration import parse_calibration


def overlaid(document, members):
    """Lay members over a document's, and members of members over theirs."""
    return document | {
        name: overlaid(document[name], value)
        if isinstance(value, dict) and isinstance(document.get(name), dict)
        else value
        for name, value in members.items()
    }


def changed(result, **members):
    """A calibration with other members; of a member that is an object, only what is named is another."""
    return parse_calibration(overlaid(result.to_dict(), members))
