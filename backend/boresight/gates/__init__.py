"""Gates: what a parameter set must show before people may sign it, measured and judged apart.

==================  ============================================================================================
`gate`              what each gate asks, and which side of a limit is good
`profile`           a sensor's limits, a document that people edit
`evidence`          what the gates look at
`measurements`      every gate measured: `of_the_set`, `of_the_fit`, `held_out`, `on_board`
`judgement`         measurements held against a profile: one answer a gate, the worst decides
`assessment`        the same for files, without a store
==================  ============================================================================================
"""

from __future__ import annotations

from boresight.gates.evidence import Evidence
from boresight.gates.gate import GATES, Gate
from boresight.gates.judgement import judge, measurements_of, summarised, words
from boresight.gates.measurement import Measurement
from boresight.gates.measurements import measure
from boresight.gates.profile import DEFAULT_PROFILE, Profile, Threshold, parse_profile

__all__ = [
    "DEFAULT_PROFILE",
    "GATES",
    "Evidence",
    "Gate",
    "Measurement",
    "Profile",
    "Threshold",
    "judge",
    "measure",
    "measurements_of",
    "parse_profile",
    "summarised",
    "words",
]
