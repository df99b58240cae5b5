"""Shows on which topics the messages of a bag are answered."""

from collections.abc import Mapping
from pathlib import Path

from bo_tuner.backends.ros.play.hearing import hear
from bo_tuner.backends.ros.tuner_node import TunerNode
from bo_tuner.monitoring.display import say
from bo_tuner.study.playing import Answer, in_short
from bo_tuner.study.safe_values import safe_in_braces
from bo_tuner.study.seen import SeenNode
from bo_tuner.study.strict_yaml import dump_line
from bo_tuner.study.study import Study


def show_answers(answers: Mapping[str, Answer]) -> None:
    """Show them."""
    for topic, answer in answers.items():
        often = f", every {answer.every}," if answer.every > 1 else ""
        say(f"messages on {topic}{often} are answered on {answer.topic}")


def find_answers(study: Study, tuner: TunerNode) -> None:
    """Play the beginning of the bag of a study, and show what to write for nodes with threads."""
    play = None if study.run is None else study.run.play
    if play is None or not play.lockstep or play.answers:
        return
    nodes = [SeenNode(spec.node, {}) for spec in study.nodes.values()]
    found = hear(tuner, play.filled(safe_in_braces(study)), Path(study.folder), nodes).answers
    show_answers(found)
    if found:
        say(
            "if a node works on messages in threads of its own, it cannot be asked when it is "
            f"done: write answers: {dump_line(in_short(found))} into play"
        )
