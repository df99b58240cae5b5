"""What a run has found, as Python objects; certificates of functions."""

import sys

import pytest

import bo_tuner as bt
from bo_tuner.evidence.certificate.store import certificate_problem
from bo_tuner.storage.record import read_run
from bo_tuner.tuning.summary import with_summary


@pytest.fixture
def result(make_function_study, function, tmp_path):
    return make_function_study().optimize(function, tmp_path / "run")


def test_without_a_folder_it_lasts_as_long_as_the_result(make_function_study, function):
    result = make_function_study().optimize(function)
    folder = result.folder
    assert len(result.trials()) == 4
    assert folder.is_dir()
    del result
    assert not folder.exists()


def test_the_best_parameters_keep_the_limit(result):
    """The error is least at 0.3, where the peak is at most 1.2; the limit is 1 at a load of 2."""
    assert result.best.keys() == {"gain"}
    assert 2.0 * result.best["gain"] * 2.0 <= 1.0 + 1e-9
    assert "no limit broken" in result.verdict.headline
    assert result.verdict.headline in result._repr_html_()


def test_tables(result):
    evaluations, trials = result.evaluations(), result.trials()
    assert list(trials["number"]) == [0, 1, 2, 3]
    first = evaluations.iloc[0]
    gain, load = first["parameters.gain"], first["context.load"]
    assert first["metrics.peak"] == pytest.approx(2.0 * gain * load)
    of_first = evaluations[(evaluations["trial"] == 0) & (evaluations["stage"] == "drawn")]
    assert trials["mean.error"][0] == pytest.approx(of_first["metrics.error"].mean())


def test_tables_without_pandas(result, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    for table in (result.trials, result.evaluations):
        with pytest.raises(bt.MissingPackageError, match=r"pip install 'bo_tuner\[pandas\]'"):
            table()


def test_figures_show_themselves(result):
    figure = result.figures["convergence"]
    assert b"<svg" in figure.svg()
    assert "data:image/svg+xml;base64," in figure._repr_html_()
    assert figure.caption in figure._repr_html_()


def test_a_run_of_the_command_is_read_as_well(tuned):
    result = bt.load(tuned.path)
    assert len(result.trials()) == 7
    with pytest.raises(bt.RunRecordError, match="no such run folder"):
        bt.load(tuned.path / "nowhere")


def test_a_run_that_goes_on(make_function_study, tmp_path):
    with make_function_study().tuner(tmp_path / "run") as tuner:
        tuner.tell(tuner.ask(), {"error": 1.0, "peak": 0.5})
        result = tuner.result()
    assert result.best is None
    assert result.certificate is None
    assert len(result.evaluations()) == 1
    with pytest.raises(bt.RunRecordError, match="has no result to certify"):
        result.certify(lambda *_: {})


class TestCertificate:
    def test_of_the_result(self, result, function):
        certificate = result.certify(function)
        assert certificate.passed
        # Not by their equality: some of what is not known is NaN.
        assert repr(result.certificate) == repr(certificate)
        assert dict(certificate.parameters) == result.best
        assert "PASS" in bt.load(result.folder).verdict.headline

    def test_apply_refuses_it(self, result, function):
        """Nobody knows whether the function is what the nodes are."""
        result.certify(function)
        record = with_summary(read_run(result.folder), pytest.fail)
        assert "with a Python function" in certificate_problem(record, record.result)

    @pytest.mark.parametrize(("gain", "passed"), [(0.4, True), (0.6, False)])
    def test_of_values_that_somebody_else_tuned(self, make_function_study, function, gain, passed):
        """The peak is 4 gain in the worst context; its limit is 2."""
        study = make_function_study(constraints={"peak": bt.WorstCase("peak", upper=2.0)})
        certificate = bt.certify(function, study, parameters={"gain": gain}, runs=80)
        assert certificate.passed is passed
        assert certificate.parameters == {"gain": gain}

    def test_goes_on_after_an_interruption(self, make_function_study, function, tmp_path):
        study = make_function_study()
        calls = []

        def interrupted(parameters, context, seed):
            calls.append(seed)
            if len(calls) == 8:
                raise KeyboardInterrupt
            return function(parameters, context, seed)

        with pytest.raises(KeyboardInterrupt):
            bt.certify(interrupted, study, {"gain": 0.2}, folder=tmp_path / "cut", runs=80)
        resumed = bt.certify(interrupted, study, {"gain": 0.2}, folder=tmp_path / "cut", runs=80)
        whole = bt.certify(function, study, {"gain": 0.2}, folder=tmp_path / "whole", runs=80)
        assert resumed.evaluations_sha256 == whole.evaluations_sha256
        assert len(calls) == len(set(calls)) + 1

    def test_in_the_folder_of_a_run(self, result, function, make_function_study):
        """Its certificates are those of its result."""
        with pytest.raises(bt.RunRecordError, match="is the folder of a run; name another one"):
            bt.certify(function, make_function_study(), {"gain": 0.2}, folder=result.folder)

    def test_of_what_is_no_parameter_set(self, make_function_study, function):
        study = make_function_study()
        for given, said in (
            ({"gian": 0.5}, "gian"),
            ({"gain": 7.0}, "gain"),
            ({"gain": "much"}, "gain"),
            ([1], "expected a mapping, found a list of 1"),
        ):
            with pytest.raises(bt.StudyError, match=said):
                bt.certify(function, study, given)

    def test_of_what_is_no_study(self, make_function_study, function):
        with pytest.raises(bt.StudyError, match="study: expected a Study, found a function"):
            bt.certify(make_function_study(), function)

    def test_of_too_few_draws(self, make_function_study, function):
        with pytest.raises(bt.StudyError, match="runs: expected at least 77"):
            bt.certify(function, make_function_study(), runs=1)
        with pytest.raises(bt.StudyError, match="runs: expected an integer, found text '60'"):
            bt.certify(function, make_function_study(), runs="60")
        with pytest.raises(bt.StudyError, match="confidence: expected"):
            bt.certify(function, make_function_study(), confidence=1.5)
