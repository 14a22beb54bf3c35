"""An interrupt at a chosen line of chosen functions."""

import contextlib
import sys


@contextlib.contextmanager
def interrupted_after(lines, *functions):
    """Raise one interrupt, as a signal does, once so many lines of some functions have been run."""
    codes = {function.__code__ for function in functions}
    left = lines

    def interrupt(frame, event, _):
        nonlocal left
        if frame.f_code not in codes:
            return None
        if event == "line":
            left -= 1
            if left == -1:
                raise KeyboardInterrupt
        return interrupt

    before = sys.gettrace()
    sys.settrace(interrupt)
    try:
        yield
    finally:
        sys.settrace(before)
