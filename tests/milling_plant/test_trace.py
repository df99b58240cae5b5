"""The signals of a cut that an in-process plant hands out."""

import numpy as np
import pytest
from cuts import Constant

from milling_plant.cut import MillingPlant, reference_velocity
from mpc_controller.controller import MpcController


def test_there_are_no_signals_before_a_cut():
    assert MillingPlant().trace() == {}


def test_signals_are_those_of_the_cut():
    plant = MillingPlant()
    result = plant.run_cut(MpcController())
    signals = {name: values for name, (_, values) in plant.trace().items()}
    reference = reference_velocity(plant.settings)
    np.testing.assert_allclose(signals["time"], 0.02 * np.arange(270), atol=1e-12)
    np.testing.assert_array_equal(signals["velocity/reference"], reference)
    np.testing.assert_array_equal(signals["velocity/actual"], plant.velocity)
    error = signals["velocity error"]
    assert np.sum(error**2) == pytest.approx(result["tracking_error"], rel=1e-12)
    # The position error is the integral of the velocity error.
    np.testing.assert_allclose(np.diff(signals["position error"]), 0.02 * error[1:], atol=1e-15)


def test_units_are_told():
    plant = MillingPlant()
    plant.run_cut(Constant(0.5))
    units = {name: unit for name, (unit, _) in plant.trace().items()}
    assert units["time"] == "s"
    assert units["position error"] == "m"
    assert units["command"] == "m/s"
    assert plant.trace()["command"][1].tolist() == [0.5] * 270


def test_a_cut_that_failed_has_signals_as_far_as_it_went():
    plant = MillingPlant()
    result = plant.run_cut(Constant(1e4))
    assert result["status"] == "failed"
    lengths = {len(values) for _, values in plant.trace().values()}
    assert len(lengths) == 1
    assert 0 < lengths.pop() < 270
