"""When a run pauses: what signals ask, what the clock says, and that all of it is decided at safe points."""

import signal
import time
from types import SimpleNamespace

import numpy as np
import pytest

from pdfem_mpi.deck.outputs import Checkpoint
from pdfem_mpi.parallel import stop_requests as pausing
from pdfem_mpi.parallel import watchdog
from pdfem_mpi.parallel.comm import broadcast, largest, mpi, on_root, sum_integers
from pdfem_mpi.parallel.slabs import gather_pairs, gather_slabs
from pdfem_mpi.parallel.stop_requests import Stopped, StopRequests
from pdfem_mpi.parallel.watchdog import Watchdog
from pdfem_mpi.system import signals
from pdfem_mpi.system.signals import Requests
from support.helpers import run_python


class Checkpoints:
    """Counts checkpoints; they may fail."""

    def __init__(self, works=True):
        self.works, self.saved = works, []

    def save(self, state):
        self.saved.append((state.step, state.iteration))
        return self.works

    def remember(self, state):
        pass


def state(step=0, iteration=0):
    return SimpleNamespace(step=step, iteration=iteration, spent=iteration, program={})


@pytest.fixture
def clock(monkeypatch):
    """A clock that is set by hand."""
    now = [1000.0]
    for module in (pausing, signals):
        monkeypatch.setattr(module, "monotonic", lambda: now[0])
    return now


def stop_requests(checkpoints=None, requests=None, end=None, **settings):
    requests, checkpoints = requests or Requests(), checkpoints or Checkpoints()
    return StopRequests(mpi().COMM_SELF, requests, checkpoints, Checkpoint(**settings), end)


# --- signals ----------------------------------------------------------------------------------------------


def test_a_signal_sets_a_flag_and_a_second_one_ends_all_ranks(clock):
    """Within a second it is the same signal: batch system and launcher both pass it on."""
    codes = []
    requests = Requests()
    requests.comm = SimpleNamespace(Abort=codes.append, size=2)
    requests.handle(signal.SIGUSR1)
    clock[0] += 0.9
    requests.handle(signal.SIGTERM)
    assert requests.stop and codes == []
    clock[0] += 0.2
    requests.handle(signal.SIGTERM)
    assert codes == [70]


INSTALLED = """
import os, signal, sys, time
from pdfem_mpi.system import signals
from pdfem_mpi.system.signals import Requests
requests = Requests()
requests.install()
for name in sys.argv[1:]:
    os.kill(os.getpid(), getattr(signal, name))
    time.sleep(0.1)
print(requests.stop, flush=True)
signals.SAME_SIGNAL_SECONDS = 0.0
os.kill(os.getpid(), signal.SIGTERM)
time.sleep(0.2)
os.kill(os.getpid(), signal.SIGTERM)
time.sleep(5.0)
"""


@pytest.mark.parametrize(("name", "stops"), [("SIGUSR1", True), ("SIGTERM", True), ("SIGUSR2", False)])
def test_installed_handlers(name, stops):
    """The first signal is noted, two end the process; before MPI has started as well."""
    result = run_python("-c", INSTALLED, name)
    assert (result.returncode, result.stdout) == (70, f"{stops}\n")
    assert ("most recent call first" in result.stderr) == (name == "SIGUSR2")
    assert "SIGTERM a second time: ending at once" in result.stderr


ENDING = """
import os, signal, sys, weakref
from pdfem_mpi.system.signals import Requests
class Late:
    def __del__(self):
        for name in ("SIGUSR1", "SIGTERM"):
            os.kill(os.getpid(), getattr(signal, name))
        os.write(1, b"still here")
requests = Requests()
requests.install()
sys.modules["late"] = Late()  # let go after Python has taken its handlers away
if sys.argv[1] == "over":
    requests.come_too_late()
"""


@pytest.mark.parametrize("over", [True, False])
def test_a_signal_that_comes_too_late_changes_nothing(over):
    """Python gives up its handlers while it ends: a run that has finished would end by the signal."""
    result = run_python("-c", ENDING, "over" if over else "not")
    assert (result.returncode, result.stdout) == ((0, "still here") if over else (-10, ""))


def test_handlers_need_neither_numpy_nor_mpi():
    """They are installed before either loads, which takes a second."""
    code = "import sys, pdfem_mpi.system.signals; sys.exit(any(name in sys.modules for name in ('numpy', 'mpi4py')))"
    assert run_python("-c", code).returncode == 0


# --- safe points ------------------------------------------------------------------------------------------


def test_a_stop_keeps_the_state_and_ends_the_run(clock):
    checkpoints, requests = Checkpoints(), Requests()
    asked = stop_requests(checkpoints, requests)
    asked.act(asked.votes(), state(1, 5))
    assert checkpoints.saved == []
    requests.handle(signal.SIGUSR1)
    with pytest.raises(Stopped, match="asked to stop") as stop:
        asked.act(asked.votes(), state(1, 6))
    assert checkpoints.saved == [(1, 6)] and stop.value.kept
    with pytest.raises(Stopped):
        asked.between(state(2, 0))


def test_a_stop_says_when_nothing_could_be_kept(clock):
    requests = Requests()
    requests.handle(signal.SIGUSR1)
    with pytest.raises(Stopped) as stop:
        stop_requests(Checkpoints(works=False), requests).between(state())
    assert not stop.value.kept


def test_the_votes_of_other_ranks_count(clock):
    """What is acted on are the sums over all ranks."""
    checkpoints = Checkpoints()
    with pytest.raises(Stopped):
        stop_requests(checkpoints).act((1, 0), state(0, 3))
    stop_requests(checkpoints).act((0, 1), state(0, 4))
    assert checkpoints.saved == [(0, 3), (0, 4)]


def test_no_state_is_kept_twice(clock):
    checkpoints = Checkpoints()
    asked = stop_requests(checkpoints)
    asked.resumed(state(1, 7))
    asked.save(state(1, 7))
    assert checkpoints.saved == []
    asked.save(state(1, 8))
    asked.save(state(1, 8))
    assert checkpoints.saved == [(1, 8)]


def test_minutes_between_checkpoints(clock):
    checkpoints = Checkpoints()
    asked = stop_requests(checkpoints, minutes=10.0)
    for iteration in range(1, 26):
        clock[0] += 60.0
        asked.act(asked.votes(), state(0, iteration))
    assert checkpoints.saved == [(0, 11), (0, 22)]


def test_checkpoints_take_five_percent_of_the_time_at_most(clock):
    """One that takes 2 s, asked for every second, comes every 40 s and not more often."""

    class Slow(Checkpoints):
        def save(self, state):
            clock[0] += 2.0
            return super().save(state)

    checkpoints = Slow()
    asked = stop_requests(checkpoints, minutes=1.0 / 60.0)
    start = clock[0]
    for iteration in range(400):
        clock[0] += 1.0
        asked.act(asked.votes(), state(0, iteration))
    assert 8 <= len(checkpoints.saved) <= 11 and 2.0 * len(checkpoints.saved) <= 0.055 * (clock[0] - start)


def test_iterations_and_steps_between_checkpoints(clock):
    checkpoints = Checkpoints()
    asked = stop_requests(checkpoints, iterations=3, steps=2)
    for step in range(5):
        asked.between(state(step, 9))
        for iteration in range(1, 8):
            asked.act(asked.votes(), state(step, iteration))
    inner = [(step, iteration) for step in range(5) for iteration in (3, 6)]
    assert [place for place in checkpoints.saved if place in inner] == inner
    assert (2, 9) not in checkpoints.saved  # two iterations' checkpoints are since the step began


def test_steps_between_checkpoints(clock):
    checkpoints = Checkpoints()
    asked = stop_requests(checkpoints, steps=2)
    for step in range(7):
        asked.between(state(step))
    assert checkpoints.saved == [(2, 0), (4, 0), (6, 0)]


def test_the_time_allowed_ends_early_enough_for_a_checkpoint(clock):
    checkpoints = Checkpoints()
    asked = stop_requests(checkpoints, end=1100.0)
    clock[0] = 1097.0
    asked.between(state(1))
    clock[0] = 1098.5
    with pytest.raises(Stopped, match="--max-hours is used up"):
        asked.between(state(2))
    assert checkpoints.saved == [(2, 0)]


def test_nobody_can_set_the_clock_back(monkeypatch):
    """The time of day is not asked at all."""
    monkeypatch.setattr(time, "time", lambda: 0.0)
    asked = stop_requests(end=time.monotonic() - 1.0)
    with pytest.raises(Stopped):
        asked.between(state())


# --- watchdog ---------------------------------------------------------------------------------------------


def test_the_limit_follows_the_beats(monkeypatch, tmp_path):
    now = [0.0]
    monkeypatch.setattr(watchdog, "monotonic", lambda: now[0])
    monkeypatch.setattr(watchdog.faulthandler, "dump_traceback_later", lambda *a, **o: None)
    dog = Watchdog(mpi().COMM_SELF, tmp_path / "hang", 300.0)
    for _ in range(20):
        now[0] += 1.0
        dog.beat()
    assert dog.limit() == 300.0
    now[0] += 60.0  # an evaluation of a large body
    dog.beat()
    for _ in range(dog.BEATS - 1):  # and sums that follow each other
        dog.beat()
    assert dog.limit() == 600.0
    dog.beat()
    assert dog.limit() == 300.0


def test_what_the_others_say_is_a_beat(monkeypatch, tmp_path):
    """Within the watchdog every collective is; afterwards none."""
    comm = mpi().COMM_SELF
    rows = np.zeros((3, 2))
    pairs = np.array([[0, 1]])
    beats = []
    monkeypatch.setattr(Watchdog, "beat", lambda dog: beats.append(1))
    words = {
        "sum": lambda: sum_integers(comm, np.array([1])),
        "largest": lambda: largest(comm, np.array([1.0])),
        "broadcast": lambda: broadcast(comm, 1),
        "on root": lambda: on_root(comm, lambda: None),
        "slabs": lambda: list(gather_slabs(comm, np.arange(3), rows, 3)),
        "pairs": lambda: list(gather_pairs(comm, pairs, 2)),
    }
    with Watchdog(comm, tmp_path / "hang", 300.0):
        for name, word in words.items():
            before = len(beats)
            word()
            assert len(beats) > before, name
    before = len(beats)
    for word in words.values():
        word()
    assert len(beats) == before


HANG = """
import sys, time
from types import SimpleNamespace
import os
from pdfem_mpi.parallel.watchdog import Watchdog
with Watchdog(SimpleNamespace(rank=3, Abort=os._exit), sys.argv[1], 0.3) as dog:
    for _ in range(5):
        time.sleep(0.1)
        dog.beat()
    print("alive", flush=True)
    def stuck():
        time.sleep(20)
    stuck()
"""


def test_a_rank_that_hangs_ends_all_with_its_stack(tmp_path):
    start = time.monotonic()
    result = run_python("-c", HANG, tmp_path / "run.r3.hang")
    assert result.stdout == "alive\n"
    assert result.returncode == 70 and time.monotonic() - start < 10
    assert "[rank 3] no progress" in result.stderr
    assert "in stuck" in (tmp_path / "run.r3.hang").read_text()


LOCKED = HANG.replace("time.sleep(20)", "import re; re.match(r'(a|aa)+$', 'a' * 60 + 'b')")


def test_where_even_the_watchdog_cannot_run_the_process_ends(tmp_path):
    """A regular expression holds Python's lock for hours: the timer of faulthandler needs no lock."""
    result = run_python("-c", LOCKED, tmp_path / "hang", timeout=30)
    assert result.returncode == 1
    assert "Timeout" in result.stderr and "in stuck" in result.stderr
