"""The same by ask and tell: for runs that are made elsewhere, or by hand, and take their time.

Stop it with Ctrl-C at any time, and start it again: it goes on.
"""

import sys

from position_loop import study, turn

import bo_tuner as bt

folder = sys.argv[1] if len(sys.argv) > 1 else "runs/by_hand"
with study.tuner(folder, window=2) as tuner:
    waiting = []
    while True:
        try:
            run = tuner.ask()
        except bt.WindowFull:
            # Two runs are under way; the one that began last happens to end first.
            run = waiting.pop()
            try:
                tuner.tell(run, turn(run.parameters, run.context, run.seed))
            except bt.Failed as failure:
                tuner.fail(run, str(failure))
            continue
        if run is None:
            break
        waiting.append(run)
    print(tuner.result())
