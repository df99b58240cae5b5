"""A question that may be answered in several places: the first answer counts."""

from bo_tuner.tuning.question import Asked, Given, Question, Reply


def test_the_first_answer_to_the_question_at_hand_counts():
    question, accept = Question(), Given(Reply.ACCEPT, "terminal")
    assert not question.answer(accept), "nothing is asked"
    question.pose(Asked(3, "start", "trial before", ()))
    assert not question.answer(accept, number=0), "an earlier one was read"
    assert question.given is None
    refuse = Given(Reply.REFUSE, "live page", "127.0.0.1")
    assert question.answer(refuse, number=1)
    assert not question.answer(accept)
    assert question.given == refuse
    question.close()
    assert question.asked is None
    question.pose(Asked(4, "start", "trial before", ()))
    assert (question.number, question.given) == (2, None)
    assert not question.answer(accept, number=1)
    question.close()
    assert not question.answer(accept)
