from bo_tuner.study.study_file import load_study
from tuning_benchmark.campaign.calibration import calibrate
from tuning_benchmark.experiments.experiment import Calibration


def test_calibration_compares_what_the_study_permits():
    given = Calibration(
        study=load_study("full"),
        metric="return_time",
        node="controller",
        parameter="return_time",
        modelled="modelled",
        measured="measured",
        grid={"control_horizon": (2, 8), "prediction_horizon": (4, 8)},
        repeats=1,
    )
    result = calibrate(given)
    horizons = [tuple(p["parameters"].values())[:2] for p in result["points"]]
    # Eight moves in a horizon of four are not permitted.
    assert horizons == [(2, 4), (2, 8), (8, 8)]
    assert all(point["modelled"] > 0 for point in result["points"])
    longer = {h: p["modelled"] for h, p in zip(horizons, result["points"], strict=True)}
    assert longer[8, 8] > longer[2, 8]
