"""A choice of a camera, written by hand: two cameras, one term needed and one not."""

from dataclasses import replace

from boresight.calibration.calibration import Values
from boresight.calibration.choice.result import (
    Candidate,
    Choice,
    ChosenCamera,
    HeldOutBy,
    NoiseFound,
    OtherCamera,
    State,
    Sufficiency,
    TermTest,
    say,
)

PARAMETERS = {
    "f_m": 0.0161, "m0_px": 972.0, "n0_px": 1296.0, "b4_per_m4": 0.0, "b2_per_m2": 120.0, "a1_rad": 0.0, "a2_rad": 0.0, "g_y": 1.0,
}  # fmt: skip


def candidate(camera_model="inverted_wang", free=("f_m",), terms=(), rms_rad=3.1e-5, **others):
    numbers = {
        "chi2": 812.4,
        "dof": 800,
        "bic": 830.2,
        "rms_arc_rad": 3e-5,
        "change_px": 0.12,
        "change_3_sigma_px": 0.03,
    }
    interval = None if rms_rad is None else [0.9 * rms_rad, 1.1 * rms_rad]
    return Candidate(
        camera_model=camera_model, free=list(free), terms=list(terms), state=others.pop("state", State.DETERMINED),
        held_out_rms_arc_rad=rms_rad, held_out_interval_rad=interval, **numbers | others,
    )  # fmt: skip


def made_test(*terms, needed):
    return TermTest(
        camera_model="inverted_wang", terms=list(terms), chi2_difference=91.5 if needed else 0.4, df=1, p=1e-21 if needed else 0.5,
        log10_p=-21.0 if needed else -0.3, looked_at=9, p_corrected=9e-21 if needed else 1.0,
        log10_p_corrected=-20.0 if needed else 0.0, needed=needed, held_out_ratio=0.8, change_px=0.4, change_3_sigma_px=0.1,
    )  # fmt: skip


def made_choice(**members):
    models = [
        candidate(rms_rad=3.9e-5, bic=901.0),
        candidate(free=("f_m", "b2_per_m2"), terms=("radial r³",), change_px=0.0, change_3_sigma_px=0.0),
        candidate("brown_conrady", ("f_m", "k1"), ("radial r³",), bic=834.0),
        candidate("kannala_brandt", ("f_m", "k1"), ("radial r³",), None, state=State.UNDETERMINED, bic=None, chi2=None),
    ]
    noise = NoiseFound(variance=1.01, dof=790, as_stated=True)
    free = ["f_m", "b2_per_m2"]
    made = Choice(
        sensor="ST16-1",
        sensor_camera_model="inverted_wang",
        sufficiency=Sufficiency.SUFFICES,
        chosen=ChosenCamera(
            camera_model="inverted_wang", free=free, terms=["radial r³"], place=1,
            parameters=Values(PARAMETERS), sigma=Values({"f_m": 1e-7, "b2_per_m2": 2.0}),
        ),
        models=models,
        needed=[made_test("radial r³", needed=True)],
        beyond=[made_test("tilt", needed=False)],
        other_cameras=[OtherCamera(camera_model="brown_conrady", place=2, bic_above=3.8)],
        leftover=None,
        noise=noise,
        noise_of_chosen=noise,
        level=0.01,
        held_out_by=HeldOutBy.CROSS_VALIDATION,
        matched_with="inverted_wang",
        frames=30,
        stars=400,
        arcs=710,
        **members,
    )  # fmt: skip
    return made if made.sentence else replace(made, sentence=say(made))
