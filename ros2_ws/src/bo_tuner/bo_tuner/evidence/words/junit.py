"""A verdict as JUnit XML, which CI servers show: a test case for each limit, and one for all."""

from xml.etree import ElementTree

from bo_tuner.evidence.verdict import PASS, Verdict
from bo_tuner.evidence.words.limits import in_words
from bo_tuner.evidence.words.quantities import details
from bo_tuner.evidence.words.verdict import headline, reasons, sentences
from bo_tuner.study.limits import Standing
from bo_tuner.study.study import Study
from bo_tuner.text import printable, with_unit

ALL = "all limits"
"""Name of the test case that fails with the verdict, also for what is of no single limit."""


def verdict_in_junit(study: Study, verdict: Verdict) -> bytes:
    """Return the XML of the verdict of a certificate."""
    suite = _suite(study)
    for quantity in verdict.quantities:
        if quantity.limit_verdict is None or quantity.limit_verdict.standing is Standing.SHOWN:
            continue
        label = with_unit(quantity.label, quantity.unit)
        number = f"{label} {quantity.values_in_words[1]}, limit {quantity.limit_in_words}"
        text = "; ".join(filter(None, (number, details(quantity))))
        _mark(suite, quantity.constraint, "failure", in_words(quantity.limit_verdict), text)
    if verdict.certificate != PASS:
        _mark(suite, ALL, "failure", headline(verdict), "\n".join(reasons(verdict)))
    said = "\n".join([headline(verdict), *sentences(verdict)])
    ElementTree.SubElement(suite, "system-out").text = printable(said)
    return _xml(suite)


def no_verdict_in_junit(study: Study) -> bytes:
    """Return the XML of a certificate that is not there: each test case is an error."""
    suite = _suite(study)
    for name in (*study.constraints, ALL):
        _mark(suite, name, "error", "no verdict: validate has not come to its end")
    return _xml(suite)


def _suite(study: Study) -> ElementTree.Element:
    names = [*study.constraints, ALL]
    suite = ElementTree.Element(
        "testsuite", name=study.name, tests=str(len(names)), failures="0", errors="0"
    )
    for name in names:
        ElementTree.SubElement(suite, "testcase", classname=study.name, name=name)
    return suite


def _mark(
    suite: ElementTree.Element, name: str, kind: str, message: str, details: str = ""
) -> None:
    """Add a failure or an error to the test case of a name, and count it."""
    (case,) = [case for case in suite.iter("testcase") if case.get("name") == name]
    mark = ElementTree.SubElement(case, kind, message=printable(message))
    mark.text = printable(details)
    count = f"{kind}s"
    suite.set(count, str(int(suite.get(count, "0")) + 1))


def _xml(suite: ElementTree.Element) -> bytes:
    suites = ElementTree.Element("testsuites")
    suites.append(suite)
    ElementTree.indent(suites)
    xml: bytes = ElementTree.tostring(suites, encoding="utf-8", xml_declaration=True)
    return xml + b"\n"
