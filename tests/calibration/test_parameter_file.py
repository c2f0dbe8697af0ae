"""A parameters file that no lens has is refused by its own name and key, not by the sensor file's."""

import json

import pytest

from boresight.calibration.parameter_file import read_parameters
from boresight.errors import RefusedInputError
from boresight.simulation.sensors import WU_TRUTH, wu_sensor

SENSOR = wu_sensor()
NAMES = ("s", "f_m", "u0_px", "v0_px", "k1", "k2")
SOUND = dict(zip(NAMES, WU_TRUTH.tolist(), strict=True))
UNSOUND = {
    "a distortion that turns back before the corner at row -0.5, column -0.5": {"k1": -10.0, "k2": 0.0},
    "the principal point at row 550, column -1990, far off the detector": {"u0_px": -1990.0},
}


@pytest.fixture
def written(tmp_path):
    def write(document):
        path = tmp_path / "downlinked.json"
        path.write_text(json.dumps(document))
        return path

    return write


@pytest.mark.parametrize(("said", "changed"), UNSOUND.items(), ids=["turn", "principal point"])
def test_what_no_lens_has_is_refused_under_the_name_and_key_of_the_file(written, said, changed):
    for document, subject in (
        ({"parameters": SOUND | changed}, "the set under 'parameters'"),
        (SOUND | changed, "the set of parameters"),
    ):
        with pytest.raises(RefusedInputError) as refused:
            read_parameters(written(document), SENSOR)
        assert str(refused.value).startswith(f"downlinked.json: {subject} ")
        assert said in str(refused.value)
        assert "initial" not in str(refused.value)


def test_a_sound_file_is_read_in_the_camera_s_order(written):
    x, P = read_parameters(written({"parameters": SOUND}), SENSOR)
    assert x.tolist() == WU_TRUTH.tolist()
    assert P is None
