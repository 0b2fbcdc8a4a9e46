"""Whether the machine itself was late: what fails meanwhile is tried again."""

import threading
import time

# A sampler sleeps so long, and a machine that wakes it so much later is late [s].
PAUSE_S, LATE_S = 0.005, 0.01
TRIES = 3


class Sampler:
    """A thread that measures how late it is woken, while the context is open."""

    def __enter__(self):
        self.late_s, self.ended = 0.0, threading.Event()
        self.thread = threading.Thread(target=self.sample)
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.ended.set()
        self.thread.join()

    def sample(self):
        """Sleeps until the end."""
        while not self.ended.is_set():
            begun = time.monotonic()
            self.ended.wait(PAUSE_S)
            self.late_s = max(self.late_s, time.monotonic() - begun - PAUSE_S)


def repeat_when_late(case, failed):
    """What a case says; one that raises `failed` on a late machine is tried again. The last try counts in any case."""
    for number in range(1, TRIES + 1):
        with Sampler() as sampler:
            try:
                return case()
            except failed as failure:
                reason = failure
        if sampler.late_s < LATE_S or number == TRIES:
            raise reason
        print(f"try {number} does not count, the machine woke a thread {1e3 * sampler.late_s:.0f} ms late: {reason}", flush=True)
