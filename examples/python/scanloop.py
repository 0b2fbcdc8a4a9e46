"""A process of Scanloop in Python, on iceoryx2's own bindings.

    from scanloop import Process, Role
    from scanloop_types import Command, Obstacles, Pose

    process = Process(Role.CONTROLLER)
    poses, obstacles = process.input(Pose), process.input(Obstacles)
    commands = process.output(Command)
    if process.start():
        while process.wait():
            for pose, described in process.join(poses, obstacles):
                command = plan(pose, described)             # yours
                command.header = answer(described, pose)    # first the sample that comes last for the role
                commands.publish(command)

It does what the Rust crate `runtime` does. It waits with a timeout, drops and counts samples that must not be used,
copies stamps into answers, publishes heartbeats and journals, keeps the start barrier, and ends on SIGTERM and SIGINT.
It copies samples out of shared memory. It checks their layout, finiteness, counts and `verified`, but no other ranges. The log of
the process and its heartbeats name each sample that was dropped for its content.

Needs Python 3.11 and the packages of requirements.txt.
"""

import collections
import ctypes
import enum
import math
import mmap
import os
import signal
import struct
import sys
import time
import tomllib
import typing

import iceoryx2 as iox2

import scanloop_types as types
from scanloop_types import (
    Actuation,
    ActuationKind,
    BlockReason,
    Checkpoint,
    CommandKind,
    Device,
    Directive,
    Header,
    Heartbeat,
    Journal,
    JournalEntry,
    JournalKind,
    Phase,
    ProcessState,
    Refusal,
    Role,
    Rule,
)

HEARTBEAT_NS = 95_000_000  # between two heartbeats
MAX_WAIT_NS = 20_000_000  # it waits on one event only, and polls the other topics this often
STOOD_STILL_NS = 300_000_000  # a process that did not poll for so long did not run
OPEN_RETRY_NS = 5_000_000_000  # opening can collide with a clean-up, which does not take long
MAX_AGE_PERIODS, YOUNG_NS = 3, 25_000_000  # an input older than both is not used
MAX_NUMBER, MAX_STAMP_NS = 1 << 48, 1 << 62  # no scan and no sample has a larger number
MAX_SPEED, MAX_SKIPPED = 4, 2  # a scanner may be so many times as fast as its period, and skip so many scans
MAX_LEFT, MIN_INTERVAL_NS = 4096, 1_000  # samples that a publisher can have published since the last poll
MAX_LATE = 16  # a sample may come after so many newer ones
CHECKPOINT_AGE_NS = 500_000_000  # a state that was older when its process ended is not used
HANDOVER_AGE_NS = 10_000_000_000  # nor is one that has waited for longer
QUEUE_DEPTH, STANDBY_DEPTH = 12, 3  # samples that wait to be taken; samples kept of the other process of a swap
# Of a device's clock: no message is delayed by more, so an older stamp is one of a device that was restarted.
_MAX_DELAY_NS = 1_000_000_000
_WINDOW_NS, _JUMP_NS = 5_000_000_000, 20_000_000  # it stood still when all messages of a window are this late
_BACK_NS, _BACK_FOR_NS = 100_000_000, 500_000_000  # when it went back, and all are as late for this time, it was set back

# The topic that wakes a role: the one whose sample comes last.
TRIGGERS = {
    Role.ROBOT: "actuation",
    Role.ESTIMATOR: "odometry",
    Role.OBSTACLES: "pose",
    Role.CONTROLLER: "obstacles",
    Role.ACTUATOR: "command",
}


class Sample(typing.Protocol):
    """A sample of any topic: a class of scanloop_types, or of a topic of your own."""

    header: Header


S = typing.TypeVar("S", bound=Sample)
T = typing.TypeVar("T", bound=Sample)
Row = tuple[str, str, str, int, int, int]  # of a table of layouts: topic, field, kind, count, size, offset

# The place of each sample in the table of topics.
TOPIC_NUMBERS = {sample: number for number, sample in enumerate(types.TOPICS.values())}


class Handover(enum.Enum):
    """What Process.resume has found."""

    FIRST_START = 0  # there was no process before
    STATE = 1  # the state of the process before
    FOREIGN = 2  # the process before was another program, whose state is of another kind
    LOST = 3  # its state is too old or was never saved: publish nothing unless your outputs need no memory


def answer(to: Sample, also: Sample | None = None) -> Header:
    """The header of an answer to one sample, or to two of one scan: the same scan, with the stamps of both.

    Of two samples, `to` is the one that comes last for the role; `also` adds the stamps that `to` does not have.
    """
    header = Header.from_buffer_copy(to.header)
    header.layout = header.incarnation = header.sequence = 0
    if also is not None:
        for mine, theirs in zip(header.chain, also.header.chain):
            if mine.published_ns == 0:
                ctypes.memmove(ctypes.byref(mine), ctypes.byref(theirs), ctypes.sizeof(mine))
    return header


def current_goal(directive: Directive, scan_id: int, goal: dict[str, typing.Any]) -> dict[str, typing.Any]:
    """Where to land in a scan: `goal`, that of the scan before, or the first goal as it was set last while driving."""
    given = directive.goal
    if given.index != 0 or not 0 < given.from_scan <= scan_id:
        return goal
    return {"x_m": given.x_m, "y_m": given.y_m, "tolerance_m": given.tolerance_m}


def _orders(directive: Directive) -> tuple[int, int, int]:
    """What tells that a directive has other orders for stages than another."""
    return directive.goal.from_scan, directive.driven_by, directive.person.number


def difference(mine: list[Row], theirs: list[Row], topics: typing.Iterable[str]) -> str | None:
    """The first difference between two tables of layouts, as text; None when `topics` have the same layout."""
    for topic in topics:
        found = _deviation([row[1:] for row in mine if row[0] == topic], [row[1:] for row in theirs if row[0] == topic])
        if found:
            field, what = found
            return f"topic {topic}: {'the sample' if field == '.' else 'field ' + field} {what}"
    return None


def _deviation(mine, theirs):
    def within(field, outer):
        return outer == "." or field == outer or field.startswith(outer + ".")

    scalars = ("u8", "u16", "u32", "u64", "i32", "f64")
    whole = None  # a difference of a struct, reported only when its fields do not differ
    for index in range(max(len(mine), len(theirs))):
        my = mine[index] if index < len(mine) else None
        their = theirs[index] if index < len(theirs) else None
        if whole and not any(row and within(row[0], whole[0]) for row in (my, their)):
            return whole
        if my is None:
            return their[0], "is missing in this process"
        if their is None:
            return my[0], "is not in the samples of the system"
        (field, kind, count, size, offset), (name, their_kind, their_count, their_size, their_offset) = my, their
        if field != name:
            here = next((row for row in mine if row[0] == name), None)
            there = next((row for row in theirs if row[0] == field), None)
            if here and there:
                return name, f"begins at byte {here[4]} in this process, at {their_offset} in the system"
            if here:
                return field, "is not in the samples of the system"
            return name, "is missing in this process" if there else f"is called {field} in this process"
        both = kind not in scalars and their_kind not in scalars
        kinds = f"is of type {kind} in this process, {their_kind} in the system"
        if kind != their_kind and not both:
            return field, kinds
        if count != their_count:
            return field, f"has {count} elements in this process, {their_count} in the system"
        if offset != their_offset:
            return field, f"begins at byte {offset} in this process, at {their_offset} in the system"
        sizes = f"has {size} bytes in this process, {their_size} in the system"
        if kind != their_kind:
            whole = field, kinds
        elif size != their_size and both:
            whole = field, sizes
        elif size != their_size:
            return field, sizes
    return whole


def read_layouts(text: str) -> list[Row]:
    """The table of layouts in the text that the orchestrator writes."""
    title, *lines = text.splitlines()
    if title != "scanloop layouts 1":
        _refuse(f"layouts.txt begins with `{title}`, which this module does not know")
    rows = (line.split(" ") for line in lines)
    return [(row[0], row[1], row[2], int(row[3]), int(row[4]), int(row[5])) for row in rows]


class Wheels(enum.IntEnum):
    """What the wheels do."""

    UNKNOWN, TURNING, BLOCKED, RESTING = range(4)


class StopWord:
    """The page of memory that stops a run: the robot drives only while it holds the armed value."""

    ARMED, WORD_AT, ROWS_AT, ROW = 0x5CA1AB1ED01ED0E5, 8, 64, 64

    def __init__(self, role):
        self._role, self._page = role, None
        try:
            self._page = mmap.mmap(int(os.environ["SCANLOOP_STOP_FD"]), 4096)
        except (KeyError, ValueError, OSError):
            print("warning: this process will not see the stop word, and is ended when the run is stopped", file=sys.stderr)

    def is_armed(self) -> bool:
        """Whether wheels may turn."""
        return self._page is None or struct.unpack_from("=Q", self._page, self.WORD_AT)[0] == self.ARMED

    def report(self, wheels: Wheels) -> None:
        """Writes what the wheels do; `scanloop stop` reads it."""
        if self._page is not None and wheels != Wheels.UNKNOWN:
            place = self.ROWS_AT + self._role * self.ROW
            struct.pack_into("=QQQ", self._page, place, os.getpid(), wheels, time.monotonic_ns())


class DeviceClock:
    """Maps the stamps of a device to CLOCK_MONOTONIC, by the smallest delay of its data. A restart of the device starts
    the mapping anew. `delay_ns` is the shortest time from a stamp to the arrival of its data."""

    def __init__(self, delay_ns: int = 0) -> None:
        self._delay_ns, self._stamp_ns, self._arrived_ns = delay_ns, 0, 0
        self._offset_ns: int | None = None
        self._window_ns, self._least_ns = 0, 0  # the smallest arrival minus stamp since the start of a window
        # Since a stamp went back: when that was, the smallest and the largest arrival minus stamp.
        self._back: tuple[int, int, int] | None = None
        self.restarts, self.overtaken = 0, 0

    def map(self, stamp_ns: int, arrived_ns: int, beside: "DeviceClock | None" = None) -> int | None:
        """The time of a stamp on CLOCK_MONOTONIC; None for a message that was overtaken by others: its data are old.

        `beside` maps other data of the same clock: the smaller delay of both counts, or two kinds of data that were
        stamped at once would get two times until both have come without a delay."""
        since_ns, found_ns = arrived_ns - self._arrived_ns, arrived_ns - stamp_ns
        is_overtaken = stamp_ns < self._stamp_ns
        if is_overtaken:
            delay_ns = since_ns + self._stamp_ns - stamp_ns
            # A restarted device has lost most of its count. Nothing newer comes from one whose clock was set back.
            has_lost_count = stamp_ns < self._stamp_ns // 2
            if delay_ns <= _MAX_DELAY_NS or not (has_lost_count or since_ns > _MAX_DELAY_NS):
                self.overtaken += 1
            else:
                is_overtaken, self.restarts, self._offset_ns = False, self.restarts + 1, None
        if self._offset_ns is not None and self._is_set_back(found_ns, arrived_ns, is_overtaken):
            is_overtaken, self._offset_ns = False, None
        if is_overtaken:
            return None
        if self._offset_ns is None:
            self._offset_ns, self._window_ns, self._least_ns = found_ns, arrived_ns, found_ns
        drifted_ns = since_ns // 5000  # 200 ppm: more than two crystals drift apart
        self._offset_ns = min(found_ns, self._offset_ns + drifted_ns)
        self._least_ns = min(found_ns, self._least_ns)
        if arrived_ns - self._window_ns > _WINDOW_NS:
            if self._least_ns > self._offset_ns + _JUMP_NS:
                self._offset_ns = self._least_ns
            self._window_ns, self._least_ns = arrived_ns, found_ns
        self._stamp_ns, self._arrived_ns = stamp_ns, arrived_ns
        offset_ns = self._offset_ns - self._delay_ns
        if beside is not None and beside._offset_ns is not None:
            other_ns = beside._offset_ns - beside._delay_ns
            # Further apart they are only while one of both knows of a restart.
            is_fresh = arrived_ns - beside._arrived_ns < _MAX_DELAY_NS
            if is_fresh and abs(other_ns - offset_ns) < _MAX_DELAY_NS:
                offset_ns = min(offset_ns, other_ns)
        return stamp_ns + offset_ns

    def _is_set_back(self, found_ns, arrived_ns, is_overtaken):
        """Whether all messages are late by the same time, since one whose stamp went back: the clock was set back."""
        if found_ns - self._offset_ns < _BACK_NS:
            self._back = None
            return False
        since_ns, least_ns, most_ns = self._back or (arrived_ns, found_ns, found_ns)
        least_ns, most_ns = min(least_ns, found_ns), max(most_ns, found_ns)
        if most_ns - least_ns > _JUMP_NS:
            since_ns, least_ns, most_ns = arrived_ns, found_ns, found_ns
            self._back = None
        if self._back or is_overtaken:
            self._back = (since_ns, least_ns, most_ns)
        is_set_back = self._back is not None and arrived_ns - since_ns >= _BACK_FOR_NS
        if is_set_back:
            self._back = None
        return is_set_back


class Input(typing.Generic[S]):
    """Reads samples of one type: valid samples of the process in charge, each once and in order."""

    def __init__(self, process, sample):
        self._process, self._sample = process, sample
        self._subscriber = process._subscriber(sample)
        self._kept, self._aside = collections.deque(), collections.deque()
        self._last = (0, 0, 0)  # incarnation, sequence, scan
        self._late, self._polled_ns = 0, (0, 0)
        self._writer = next((role for role, topics in types.WRITES.items() if sample in topics), None)
        self._numbers = list(_numbers(sample, 0))
        self._refusal, self._told = Refusal(), set()

    def take(self) -> S | None:
        """The oldest sample not taken yet, or None."""
        while self._kept:
            sample = self._kept.popleft()
            if not self._process._refuses(sample):
                return self._process._taken(sample)
            self._process.counters["foreign"] += 1
        return None

    def take_newest(self) -> S | None:
        """The newest sample, or None; older ones are dropped."""
        while len(self._kept) > 1:
            self._kept.popleft()
            self._process.counters["replaced"] += 1
        return self.take()

    def _take_scan(self, scan):
        while self._kept and self._kept[0].header.scan_id < scan:
            self._kept.popleft()
            self._process.counters["replaced"] += 1
        return self.take() if self._kept and self._kept[0].header.scan_id == scan else None

    def _drain(self):
        self._polled_ns = (self._polled_ns[1], time.monotonic_ns())
        while (received := self._subscriber.receive()) is not None:
            sample = self._sample.from_buffer_copy(received.payload().contents)
            received.delete()
            self._offer(sample)

    def _review(self):
        waiting, self._aside = self._aside, collections.deque()
        for sample in waiting:
            self._offer(sample, True)

    def _offer(self, sample, was_kept=False):
        counters, header = self._process.counters, sample.header
        accepted, swapped, is_standby = True, False, False
        if self._writer is not None:
            authority = self._process.directive.authority[self._writer]
            swapped = 0 != authority.incarnation != authority.previous != 0
            counts = authority.incarnation if header.scan_id >= authority.from_scan else authority.previous
            accepted = counts != 0 and counts == header.incarnation
            is_standby = swapped and header.incarnation in (authority.incarnation, authority.previous)
        if fault := self._fault(sample) or self._impossible(header):
            counters["invalid"] += 1
            if accepted:
                self._refuse(header, *fault)
            return
        if not accepted:
            if is_standby:
                _push(self._aside, sample, STANDBY_DEPTH, counters, "foreign")
            else:
                counters["foreign"] += 1
            return
        if self._writer is not None:
            other = was_kept or swapped and header.incarnation != self._last[0]
            if other and header.scan_id <= self._last[2]:
                counters["duplicate"] += 1
                return
        if self._is_new(header):
            _push(self._kept, sample, QUEUE_DEPTH, counters, "replaced")

    def _is_new(self, header):
        counters, (incarnation, sequence, scan) = self._process.counters, self._last
        if header.incarnation == incarnation:
            # The second in a row far below shows that the newest number was wrong.
            goes_on = sequence - header.sequence > MAX_LATE and self._late + 1 == header.sequence
            if header.sequence <= sequence and not goes_on:
                self._late = header.sequence
                counters["duplicate" if header.sequence == sequence else "reordered"] += 1
                return False
            counters["missing"] += max(header.sequence - sequence - 1, 0)
        if self._writer is not None:
            self._process._note_scan(header)
        self._last = (header.incarnation, header.sequence, max(header.scan_id, scan))
        # Only the robot obeys an actuation. For other roles it is a record, which does not age.
        if self._sample is Actuation and self._process.role != Role.ROBOT:
            return True
        if not self._process.simulated and self._writer is not None and header.acquired_ns > 0:
            max_age_ns = max(MAX_AGE_PERIODS * self._process.period_ns, YOUNG_NS)
            age_ns = self._process.now_ns() - header.acquired_ns
            if age_ns > max_age_ns:
                counters["stale"] += 1
                self._refuse(header, Rule.TOO_OLD, "age_ms", age_ns * 1e-6)
                return False
        return True

    def _fault(self, sample):
        """The rule that a sample breaks, the field and its value; None when it may be used."""
        if sample.header.layout != self._sample.LAYOUT:
            return Rule.FOREIGN_LAYOUT, "header.layout", sample.header.layout
        for field, most in (("count", types.MAX_OBSTACLES), ("plan_length", types.PLAN_NODES)):
            if getattr(sample, field, 0) > most:
                return Rule.OUT_OF_RANGE, field, getattr(sample, field)
        numbers = memoryview(sample).cast("B").cast("d")
        bad = next((index for index in self._numbers if not math.isfinite(numbers[index])), None)
        if bad is not None:
            fields = [name for name, _ in sample._fields_ if getattr(type(sample), name).offset <= 8 * bad]
            return Rule.NOT_FINITE, fields[-1], 0.0
        if self._sample is types.Command and sample.kind == CommandKind.DRIVE and sample.verified != 1:
            return Rule.NOT_VERIFIED, "verified", sample.verified
        return None

    def _impossible(self, header):
        """The number that no scan, or no sample of its publisher, can have by now; None when all are possible."""
        now, process = time.monotonic_ns(), self._process
        known = header.incarnation == self._last[0]
        elapsed_ns = now - (self._polled_ns[0] if known else 0)
        most = (self._last[1] if known else 0) + MAX_LEFT + elapsed_ns // MIN_INTERVAL_NS
        for field, value, highest in (
            ("header.sequence", header.sequence, min(most, MAX_NUMBER)),
            ("header.scan_id", header.scan_id, MAX_NUMBER if self._writer is None else process._highest_scan(header)),
            ("header.acquired_ns", header.acquired_ns, MAX_STAMP_NS),
        ):
            if value > highest:
                return Rule.IMPOSSIBLE_NUMBER, field, float(value)
        return None

    def _refuse(self, header, rule, field, value):
        refusal, key = self._refusal, (header.incarnation, rule)
        refusal.count += 1
        refusal.scan_id, refusal.incarnation, refusal.rule, refusal.value = header.scan_id, header.incarnation, rule, value
        name = field.encode()[: len(refusal.field)]
        refusal.field[:] = name.ljust(len(refusal.field), b"\0")
        if key not in self._told:
            self._told.add(key)
            words = f"{self._sample.TOPIC} of incarnation {header.incarnation} for scan {header.scan_id}"
            rule = rule.name.lower().replace("_", " ")
            print(f"warning: dropped {words}: {rule}: {field} = {value}", file=sys.stderr, flush=True)


class Output(typing.Generic[S]):
    """Writes samples of one type."""

    def __init__(self, process, sample):
        self._process, self._sample, self._sequence = process, sample, 0
        self._service = process._samples(sample)
        builder = self._service.publisher_builder().max_loaned_samples(1)
        self._publisher = builder.backpressure_strategy(iox2.BackpressureStrategy.DiscardData).create()
        self._notifier = process._events(sample).notifier_builder().create()
        self._place, self._is_ours = None, sample in types.WRITES[process.role]

    def publish(self, sample: S, wake: bool = True) -> None:
        """Completes the header of `sample`, publishes a copy of it and wakes its readers."""
        process, header = self._process, sample.header
        computed_ns = process.now_ns()
        self._sequence += 1
        if self._sample is Actuation:
            process._hold_back(sample)
        header.layout, header.incarnation, header.sequence = self._sample.LAYOUT, process.incarnation, self._sequence
        if self._is_ours:
            stage = header.chain[process.role]
            stage.woken_ns, stage.taken_ns = process._woken_ns, process._taken_ns
            stage.computed_ns = computed_ns
            process._last_scan = header.scan_id
            if self._sample is types.WRITES[process.role][0]:
                process.counters["published"] += 1
                process._publish_journal(header.scan_id, self._sequence)
            stage.published_ns = process.now_ns()
        place, self._place = self._place or self._publisher.loan_uninit(), None
        delivered = place.write_payload(sample).send()
        if self._sample is Actuation:
            process.report_wheels(Wheels.TURNING if sample.kind == ActuationKind.DRIVE else Wheels.BLOCKED)
        if delivered < self._service.dynamic_config.number_of_subscribers:
            process.counters["undelivered"] += 1
        if wake:
            try:
                self._notifier.notify()
            except iox2.NotifierNotifyError:
                pass  # a listener that can't be notified finds the sample at its next timeout
            self._take_place()
            process._journal._take_place()

    def _take_place(self):
        """Takes the place of the next sample, while no process waits for this one."""
        self._place = self._place or self._publisher.loan_uninit()


class Process:
    """A process of the loop. Started by hand, or with other layouts than the system, it ends with exit code 2."""

    role: Role
    incarnation: int
    directory: str
    period_ns: int
    simulated: bool
    counters: collections.Counter[str]
    directive: Directive
    handed_actuations: list[Actuation]

    def __init__(self, role: Role) -> None:
        names = ("SCANLOOP_INCARNATION", "SCANLOOP_RUN_ID", "SCANLOOP_DIRECTORY")
        incarnation, run_id, directory = (os.environ.get(name) for name in names)
        if not incarnation or not run_id or not directory:
            _refuse("processes are started by `scanloop run`, or joined with `scanloop swap`")
        self.role, self.incarnation = Role(role), int(incarnation)
        self.directory = directory
        self._verify()
        own = f"{self.directory}/settings-{self.incarnation}.toml"
        of_role = f"{self.directory}/settings-{self.role.name.lower()}.toml"
        with open(own if os.path.exists(own) else of_role, "rb") as file:
            self._settings = tomllib.load(file)
        run = self._settings["run"]
        self.period_ns, self.simulated = run["period_ns"], run["clock"] == "simulated"
        self._orphan_stop_ns, self._orphan_timeout_ns = run["orphan_stop_ns"], run["orphan_timeout_ns"]
        self._stop_word, self._wheels = StopWord(self.role), Wheels.UNKNOWN
        self.counters, self._device = collections.Counter(), Device()
        self.directive = Directive()
        self.handed_actuations = []
        self._simulated_ns = self._woken_ns = self._taken_ns = self._last_scan = 0
        self._known_scan = (0, 0, 0)  # number, when it was taken, when it came
        self._ended = False
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._end)
        self._node = self._join_bus(run_id)
        self._inputs, self._outputs, self._state = [], [], ProcessState.ATTACHED
        self._directives = Input(self, Directive)
        self._heartbeat, self._checkpoint = Output(self, Heartbeat), Output(self, Checkpoint)
        self._journal, self._notes = Output(self, Journal), []
        self._listener = self._events(types.TOPICS[TRIGGERS[self.role]]).listener_builder().create()
        self._next_heartbeat_ns, self._directive_seen_ns = 0, time.monotonic_ns()
        self._polled_ns, self._absent_ns = self._directive_seen_ns, 0

    def settings(self, name: str | None = None) -> dict[str, typing.Any]:
        """The settings of the role as a dict with all keys of docs/system-file.md. For the robot it is the scenario."""
        own = "scenario" if self.role == Role.ROBOT else self.role.name.lower()
        return self._settings.get(name or own, {})

    def now_ns(self) -> int:
        """The time of the loop: CLOCK_MONOTONIC, or simulated in lock-step."""
        return self._simulated_ns if self.simulated else time.monotonic_ns()

    def input(self, sample: type[S]) -> Input[S]:
        """Opens a topic for reading; samples arrive from start() on."""
        if sample not in types.READS[self.role]:
            _refuse(f"role {self.role.name.lower()} does not read topic {sample.TOPIC}")
        self._inputs.append(Input(self, sample))
        return self._inputs[-1]

    def output(self, sample: type[S]) -> Output[S]:
        """Opens a topic for writing."""
        if sample not in types.WRITES[self.role]:
            _refuse(f"role {self.role.name.lower()} does not write topic {sample.TOPIC}")
        self._outputs.append(Output(self, sample))
        return self._outputs[-1]

    def start(self) -> bool:
        """Waits until all processes are there and connected; False when asked to end."""
        self._beat()
        while self._sleep(MAX_WAIT_NS):
            phase = self.directive.phase
            if phase >= Phase.CONNECTING and self._state == ProcessState.ATTACHED:
                for output in [*self._outputs, self._checkpoint, self._journal]:
                    output._publisher.update_connections()
                self._enter(ProcessState.CONNECTED)
            if phase >= Phase.DRIVING:
                return True
            if self.directive.issued_ns > 0:
                self._known_scan = (0, self.now_ns(), self.now_ns())  # no scan was published yet
        return False

    def wait(self, deadline_ns: int | None = None) -> bool:
        """Sleeps until a sample may have come, or the time `deadline_ns` has passed; False when asked to end."""
        if self.counters["published"] and self._state == ProcessState.CONNECTED:
            self._enter(ProcessState.READY)
        longest = MAX_WAIT_NS
        if deadline_ns is not None and not self.simulated:
            longest = min(longest, max(deadline_ns - time.monotonic_ns(), 0))
        return self._sleep(longest)

    def join(self, one: Input[S], other: Input[T]) -> typing.Iterator[tuple[S, T]]:
        """The newest pairs of samples of one scan. Older samples are dropped, even if there is time for them."""
        while True:
            scans = {sample.header.scan_id for sample in one._kept} & {sample.header.scan_id for sample in other._kept}
            if not scans:
                return
            yield one._take_scan(max(scans)), other._take_scan(max(scans))

    def save(self, header: Header, kind: int, state: bytes) -> None:
        """Saves the state of this process after a scan, as bytes; `kind` is a number of your own for their layout."""
        checkpoint = Checkpoint(role=self.role, state_layout=kind, length=len(state), issued_ns=time.monotonic_ns())
        checkpoint.header = Header.from_buffer_copy(header)
        ctypes.memmove(checkpoint.bytes, state, min(len(state), types.CHECKPOINT_BYTES))
        self._checkpoint.publish(checkpoint, wake=False)
        self._note(JournalKind.SAVED, checkpoint.header.sequence)

    def resume(self, kind: int) -> tuple[Handover, bytes | None]:
        """The state that the process before this one has saved: a Handover, and the bytes or None.

        With a state, `handed_actuations` has the newest actuations, oldest first, for a role that reads them. The
        process before may not have received the last of them.
        """
        if os.environ.get("SCANLOOP_RESTART") != "1":
            return Handover.FIRST_START, None
        try:
            with open(f"{self.directory}/{self.role.name.lower()}.checkpoint", "rb") as file:
                data = file.read()
            checkpoint = Checkpoint.from_buffer_copy(data)
            (ended_ns,) = struct.unpack_from("<Q", data, ctypes.sizeof(Checkpoint))
        except (OSError, ValueError, struct.error):
            return Handover.LOST, None
        now_ns = time.monotonic_ns()
        age_ns = (min(ended_ns, now_ns) if ended_ns else now_ns) - checkpoint.issued_ns
        is_old = age_ns > CHECKPOINT_AGE_NS or now_ns - checkpoint.issued_ns > HANDOVER_AGE_NS
        # In lock-step the loop waits while a process starts: its state does not age, and contains all actuations.
        if is_old and not self.simulated:
            return Handover.LOST, None
        if checkpoint.role != self.role:
            return Handover.LOST, None
        if checkpoint.state_layout != kind:
            return Handover.FOREIGN, None
        self._note_sample(JournalKind.RESUMED, checkpoint)
        header = checkpoint.header
        self._known_scan = (header.scan_id, header.acquired_ns, header.acquired_ns)
        first, size = ctypes.sizeof(Checkpoint) + 8, ctypes.sizeof(Actuation)
        places = [] if self.simulated else range(first, len(data) - size + 1, size)
        self.handed_actuations = [Actuation.from_buffer_copy(data, place) for place in places]
        for actuation in self.handed_actuations:
            self._note_sample(JournalKind.TAKEN, actuation)
        return Handover.STATE, bytes(checkpoint.bytes[: checkpoint.length])

    def _verify(self):
        try:
            with open(f"{self.directory}/layouts.txt", encoding="utf-8") as file:
                theirs = read_layouts(file.read())
        except OSError as error:
            _refuse(error)
        samples = types.READS[self.role] + types.WRITES[self.role] + [Heartbeat, Directive, Checkpoint, Journal]
        found = difference(types.layouts(), theirs, [sample.TOPIC for sample in samples])
        if found:
            _refuse(f"built against another layout: {found}; make scanloop_types.py again with `scanloop types --python`")

    def _end(self, *_):
        self._ended = True

    def must_stop(self) -> bool:
        """Whether wheels must be blocked: the run was stopped, or no directive has come for `orphan_stop_s`."""
        silent = not self.simulated and time.monotonic_ns() - self._directive_seen_ns > self._orphan_stop_ns
        return silent or not self._stop_word.is_armed()

    def report_wheels(self, wheels: Wheels) -> None:
        """Reports what the wheels do to `scanloop stop`. A robot calls this each time it is awake."""
        self._wheels = wheels
        if self.directive.authority[self.role].incarnation == self.incarnation:
            self._stop_word.report(wheels)

    def report_device(self, state: types.DeviceState, reason: str = "") -> None:
        """Reports to `scanloop status` what the devices behind this process do, and why in a few words.

        `state` is a DeviceState. A driver calls this each time it is awake.
        """
        device = self._device
        # Of a character that does not fit, no byte stays.
        text = reason.encode()[: types.DEVICE_REASON_BYTES].decode(errors="ignore").encode()
        if (device.state, bytes(device.reason).rstrip(b"\0")) != (state, text):
            since_ns = device.since_ns if device.state == state else time.monotonic_ns()
            self._device = Device(state=state, since_ns=since_ns)
            ctypes.memmove(self._device.reason, text, len(text))
            self._next_heartbeat_ns = 0

    def _hold_back(self, actuation):
        if actuation.kind == ActuationKind.DRIVE and self.must_stop():
            actuation.kind, actuation.reason = ActuationKind.BLOCK, BlockReason.STOP_REQUESTED
            actuation.desired_velocity_mps = actuation.sent_velocity_mps = 0.0
            self._note(JournalKind.HELD_BACK, 0)

    def _refuses(self, sample):
        drives = isinstance(sample, Actuation) and sample.kind == ActuationKind.DRIVE
        return drives and self.role == Role.ROBOT and self.must_stop()

    def _join_bus(self, run_id):
        iox2.set_log_level_from_env_or(iox2.LogLevel.Fatal)
        config = iox2.config.default()
        name = f"scanloop-{run_id}"
        config.global_cfg.prefix = iox2.FileName.new(f"{name}_")
        config.global_cfg.root_path = iox2.Path.new(f"/dev/shm/{name}")
        builder = iox2.NodeBuilder.new().name(iox2.NodeName.new(self.role.name.lower())).config(config)
        return builder.signal_handling_mode(iox2.SignalHandlingMode.Disabled).create(iox2.ServiceType.Ipc)

    def _service(self, sample):
        return self._node.service_builder(iox2.ServiceName.new(sample.TOPIC))

    def _samples(self, sample):
        return _retry(lambda: self._service(sample).publish_subscribe(sample).open())

    def _events(self, sample):
        return _retry(lambda: self._service(sample).event().open())

    def _subscriber(self, sample):
        builder = self._samples(sample).subscriber_builder()
        return builder.history_request(1 if sample in (Directive, Checkpoint) else 0).create()

    def _highest_scan(self, header):
        """The largest number that a scan can have by now: a scanner is at most MAX_SPEED times as fast as its period."""
        scan, acquired_ns, arrived_ns = self._known_scan
        now, latest_ns = self.now_ns(), header.acquired_ns
        if not self.simulated:
            latest_ns = min(latest_ns, now + max(MAX_AGE_PERIODS * self.period_ns, YOUNG_NS))
        since_ns = max(latest_ns - acquired_ns, now - arrived_ns, 0)
        return min(scan + 1 + MAX_SKIPPED + MAX_SPEED * since_ns // self.period_ns, MAX_NUMBER)

    def _note_scan(self, header):
        if header.scan_id >= self._known_scan[0]:
            self._known_scan = (header.scan_id, header.acquired_ns, self.now_ns())

    def _taken(self, sample):
        self._simulated_ns = max(self._simulated_ns, sample.header.chain[Role.ROBOT].published_ns)
        self._taken_ns = self.now_ns()
        if self.simulated:
            self._woken_ns = self._taken_ns
        self.counters["used"] += 1
        self._note_sample(JournalKind.TAKEN, sample)
        return sample

    def _note_sample(self, kind, sample):
        self._note(kind, sample.header.sequence, TOPIC_NUMBERS[type(sample)], sample.header.incarnation)

    def _note(self, kind, value, topic=0, incarnation=0):
        """Notes for the journal what the next output follows from."""
        if len(self._notes) == types.JOURNAL_ENTRIES:
            self._publish_journal(0, 0)
        self._notes.append(JournalEntry(kind, topic, incarnation, value))

    def _publish_journal(self, scan_id, output):
        """Before the first output of the role for a scan, or with 0 before more entries: what was noted since the last."""
        journal = Journal(role=self.role, length=len(self._notes), output=output)
        journal.header.scan_id = scan_id
        journal.entries[: len(self._notes)] = self._notes
        self._notes.clear()
        self._journal.publish(journal, wake=False)

    def _sleep(self, longest_ns):
        if time.monotonic_ns() >= self._next_heartbeat_ns:
            self._beat()
        woken = self._listen(lambda: self._listener.timed_wait(iox2.Duration.from_nanos(max(longest_ns, 1))))
        # Also after a timeout: iceoryx2 0.10 can lose a wake-up.
        while self._listen(self._listener.try_wait):
            pass
        self.counters["activations"] += 1
        self.counters["timeouts"] += not woken
        self._woken_ns = self._taken_ns = self.now_ns()
        self._directives._drain()
        if self._directives._kept:
            before, self.directive = self.directive, self._directives._kept[-1]
            self._directives._kept.clear()
            if _orders(before) != _orders(self.directive):
                self._note_sample(JournalKind.TAKEN, self.directive)
            self._directive_seen_ns, self._absent_ns = time.monotonic_ns(), 0
            for reader in self._inputs:
                reader._review()
        for reader in self._inputs:
            reader._drain()
        if self.must_stop():
            self.directive.stop = 1
        self.report_wheels(self._wheels)
        timeout_ns = self._orphan_timeout_ns if self._stop_word.is_armed() else self._orphan_stop_ns
        orphaned = self._silent_ns() > min(timeout_ns, self._orphan_timeout_ns)
        return not self._ended and not orphaned

    def _silent_ns(self):
        """How long no directive has come while this process ran: a pause of its own counts for 0.3 s at most."""
        now_ns = time.monotonic_ns()
        gap_ns, self._polled_ns = now_ns - self._polled_ns, now_ns
        silent_ns = now_ns - self._directive_seen_ns
        self._absent_ns += max(min(gap_ns, silent_ns) - STOOD_STILL_NS, 0)
        return silent_ns - self._absent_ns

    @staticmethod
    def _listen(wait):
        try:
            return bool(wait())
        except iox2.ListenerWaitError:
            return False  # a signal; the topics are polled anyway

    def _enter(self, state):
        self._state = state
        self._beat()

    def _beat(self):
        now = time.monotonic_ns()
        self._next_heartbeat_ns = now + HEARTBEAT_NS
        beat = Heartbeat(role=self.role, state=self._state, pid=os.getpid(), issued_ns=now)
        beat.obeys_stop = self._stop_word._page is not None
        beat.device = self._device
        for name, value in self.counters.items():
            setattr(beat, name, value)
        for reader in self._inputs:
            beat.refused[types.READS[self.role].index(reader._sample)] = reader._refusal
        beat.header.scan_id = self._last_scan
        self._heartbeat.publish(beat, wake=False)


def _numbers(structure, start):
    """Indices of all f64 of a sample, counted in steps of 8 bytes."""
    for name, kind in structure._fields_:
        offset, count = start + getattr(structure, name).offset, 1
        if issubclass(kind, ctypes.Array):
            kind, count = kind._type_, kind._length_
        for index in range(count):
            place = offset + index * ctypes.sizeof(kind)
            if kind is ctypes.c_double:
                yield place // 8
            elif issubclass(kind, ctypes.Structure):
                yield from _numbers(kind, place)


def _push(queue, sample, most, counters, counter):
    if len(queue) == most:
        queue.popleft()
        counters[counter] += 1
    queue.append(sample)


def _retry(open_service):
    end = time.monotonic_ns() + OPEN_RETRY_NS
    while True:
        try:
            return open_service()
        except Exception:
            if time.monotonic_ns() > end:
                raise
            time.sleep(0.005)


def _refuse(message):
    print(f"error: {message}", file=sys.stderr, flush=True)
    sys.exit(2)
