"""Topics of your own and processes beside the loop, for the module `scanloop`.

    from own_topics import Companion
    from limit import Limit                 # scanloop types --python --layout limit.toml
    from scanloop import answer
    from scanloop_types import Pose

    companion = Companion()
    poses, limits = companion.input(Pose), companion.open("limit", Limit)
    if companion.start():
        while companion.wait():
            while (pose := poses.take()) is not None:
                limits.publish(Limit(header=answer(pose), speed_mps=0.5))

A process of the loop opens a topic that `also_reads` of the system file gives to it with `open_topic(process, "limit",
Limit)`. It does what the Rust types `Companion` and `NamedTopic` of the crate `runtime` do. Samples are copied.
"""

import collections
import ctypes
import fcntl
import mmap
import os
import signal
import struct
import time
import tomllib

import iceoryx2 as iox2

import scanloop
import scanloop_types as types
from scanloop_types import Phase, ProcessState, Role, StageStamps

MAX_WAIT_NS = 100_000_000  # longest sleep
QUEUE = 16  # samples of a topic of the loop that wait at a reader, at least
LOCKSTEP_POLL_S = 0.0002  # between two checks for a sample that lock-step waits for
OPERATOR = "operator"


class Page:
    """The page that companions share with the orchestrator; offsets as in `own/page.rs` of the crate `runtime`."""

    ROLES_AT, COMPANIONS_AT, RIGHT, REPORTS_AT, REPORT = 64, 224, 32, 2304, 128

    def __init__(self, run_id):
        with open(f"/dev/shm/scanloop-{run_id}/companions.v1", "r+b") as file:
            self._page = mmap.mmap(file.fileno(), 0)
        # Words of eight bytes are written as a whole.
        self._words = memoryview(self._page).cast("Q")

    def phase(self):
        """The phase of the system."""
        return struct.unpack_from("=I", self._page, 0)[0]

    def beat_ns(self):
        """When the orchestrator took its last turn."""
        return self._words[1]

    def right(self, place):
        """Whose samples count: incarnation, previous, from_scan; the report of the process; whether lock-step waits."""
        return struct.unpack_from("=IIQII", self._page, place)

    def answered_scan(self, report):
        """The newest scan that a companion is done with."""
        return self._words[(self.REPORTS_AT + report * self.REPORT) // 8 + 5]

    def write_report(self, report, incarnation, state, counters):
        """Writes the report of this process; the scan comes last, because lock-step waits for it."""
        at = self.REPORTS_AT + report * self.REPORT
        struct.pack_into("=II", self._page, at, incarnation, state)
        names = ("pid", "activations", "taken", "answered", "answered_scan", "published", "published_ns")
        names += ("invalid", "foreign", "missed")
        words = [(at // 8 + 1 + index, counters[name]) for index, name in enumerate(names) if name != "answered_scan"]
        for word, value in [*words, (at // 8 + 5, counters["answered_scan"])]:
            self._words[word] = value


class _Cell(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_uint32) for name in ("incarnation", "version", "topic", "end", "process", "pid")),
        *((name, ctypes.c_uint64) for name in ("opened_ns", "active_ns", "delays", "delay_sum_ns", "delay_max_ns")),
        ("account", types.InputAccount),
        ("reserved", ctypes.c_uint64 * 4),
    ]


class Port:
    """What one port has counted, for the ledger; offsets as in `own/ports.rs` of the crate `runtime`."""

    READS, WRITES, MAX_COMPANIONS = 1, 2, 64

    def __init__(self, member, topic, end):
        own = [row["name"] for row in member.table.get("topic", [])]
        topics = own + [kind.TOPIC for kind in vars(types).values() if hasattr(kind, "TOPIC")]
        process = member.index if member.index is not None else self.MAX_COMPANIONS + member.role
        with open(f"/dev/shm/scanloop-{member.run_id}/ports.v1", "r+b") as file:
            table, size = mmap.mmap(file.fileno(), 0), ctypes.sizeof(_Cell)
            # Other languages take free cells from the front.
            fcntl.flock(file, fcntl.LOCK_EX)
            cells = (_Cell.from_buffer(table, at) for at in range(len(table) - size, -1, -size))
            self._cell = next((cell for cell in cells if cell.incarnation == 0), None) or _Cell()
            self._cell.incarnation = member.incarnation
        cell = self._cell
        ctypes.memset(ctypes.addressof(cell) + 4, 0, ctypes.sizeof(cell) - 4)
        cell.topic, cell.process, cell.pid = topics.index(topic), process, os.getpid()
        cell.opened_ns, cell.end, self._gaps = time.monotonic_ns(), end, 0

    def arrive(self, header):
        """Counts a sample; False when its number has come before."""
        account, (incarnation, sequence) = self._cell.account, (header.incarnation, header.sequence)
        self._cell.version |= 1  # it is odd while counts change
        account.arrived += 1
        span = next((span for span in account.writers if span.incarnation == incarnation), None)
        if span is None:
            span = min(account.writers, key=lambda span: span.incarnation)
            span.incarnation, span.first, span.last = incarnation, sequence, sequence
        elif sequence <= span.last:
            account.duplicate += 1
            return False
        else:
            self._gaps += sequence - span.last - 1
            span.last = sequence
        return True

    def settle(self, fate, count=1):
        """Counts what became of a sample."""
        self._cell.version |= 1
        setattr(self._cell.account, fate, getattr(self._cell.account, fate) + count)

    def delayed(self, since_ns):
        """A sample was taken, or published, so long after this time."""
        if since_ns and (delay_ns := time.monotonic_ns() - since_ns) >= 0:
            self._cell.delays += 1
            self._cell.delay_sum_ns += delay_ns
            self._cell.delay_max_ns = max(self._cell.delay_max_ns, delay_ns)

    def published(self, sequence):
        """A sample with that number was published."""
        self._cell.account.arrived = sequence
        self.show()

    def polled(self, kept, is_full):
        """A poll has ended, which found a full queue or not; returns how many numbers never came."""
        gaps = self._gaps
        self.settle("overwritten" if is_full else "missing", gaps)
        self._gaps = 0
        self.show(kept)
        return gaps

    def show(self, kept=()):
        """Shows when the port was used last, and what waits there."""
        account = self._cell.account
        account.waiting, account.waiting_sum = len(kept), sum(sample.header.sequence for sample in kept)
        account.open, account.open_sum = account.waiting, account.waiting_sum
        self._cell.active_ns = time.monotonic_ns()
        self._cell.version = (self._cell.version | 1) + 1


class Member:
    """What the topics of one process share."""

    def __init__(self, node, directory, run_id, incarnation, name, index=None, report=None):
        self.node, self.incarnation, self.name, self.index, self.report = node, incarnation, name, index, report
        self.run_id, self.role = run_id, Role[name.upper()].value if index is None else None
        with open(f"{directory}/own-topics.toml", "rb") as file:
            self.table = tomllib.load(file)
        with open(f"{directory}/layouts.txt", encoding="utf-8") as file:
            self.layouts = scanloop.read_layouts(file.read())
        self.page, self.state = Page(run_id), ProcessState.ATTACHED
        run = self.table["run"]
        self.simulated, self.orphan_timeout_ns = run["clock"] == "simulated", run["orphan_timeout_ns"]
        self.period_ns = run["period_ns"]
        self.counters = collections.Counter(pid=os.getpid())
        self.simulated_ns = self.woken_ns = self.taken_ns = self._open_scan = 0

    def now_ns(self):
        """The time of the loop."""
        return self.simulated_ns if self.simulated else time.monotonic_ns()

    def row(self, topic):
        """The row of a topic in the table."""
        rows = [row for row in self.table.get("topic", []) if row["name"] == topic]
        return rows[0] if rows else scanloop._refuse(f"the system has no topic {topic}")

    def companions(self):
        """The names of all companions, in the order of the page."""
        return [row["name"] for row in self.table.get("companion", [])]

    def is_first(self, topic):
        """Whether the topic is the first that this companion reads."""
        return self.index is not None and self.table["companion"][self.index]["reads"][:1] == [topic]

    def is_waited_for(self):
        """Whether lock-step waits for this process."""
        return self.index is None or self.page.right(Page.COMPANIONS_AT + self.index * Page.RIGHT)[4] == 1

    def is_over(self):
        """Whether nothing is worth waiting for any more."""
        return self.page.phase() == Phase.STOPPING or self.is_orphan()

    def is_orphan(self):
        """Whether the orchestrator is gone."""
        return time.monotonic_ns() - self.page.beat_ns() > self.orphan_timeout_ns

    def take(self, header, is_first):
        """Notes that a sample was taken."""
        self.simulated_ns = max(self.simulated_ns, header.chain[Role.ROBOT].published_ns)
        self.taken_ns = self.now_ns()
        if self.simulated:
            self.woken_ns = self.taken_ns
        if is_first:
            self.finish()
            self._open_scan = header.scan_id
            self.counters["taken"] += 1

    def finish(self):
        """The process is done with the sample that it has taken last."""
        if self._open_scan:
            self.counters["answered"] += 1
            self.counters["answered_scan"] = max(self.counters["answered_scan"], self._open_scan)
            self._open_scan = 0
        self.write()

    def write(self):
        """Writes the report of a companion."""
        if self.report is not None:
            self.page.write_report(self.report, self.incarnation, self.state, self.counters)


class Reader:
    """Reads a topic: valid samples of the process in charge, each once and in order."""

    def __init__(self, member, name, sample, source, depth):
        self._member, self._sample, self._source, self._depth = member, sample, source, depth
        self._is_first, self._kept = member.is_first(name), collections.deque()
        self._numbers, self._port = list(scanloop._numbers(sample, 0)), Port(member, name, Port.READS)
        service = member.node.service_builder(iox2.ServiceName.new(name))
        self._subscriber = scanloop._retry(lambda: service.publish_subscribe(sample).open()).subscriber_builder().create()
        events = member.node.service_builder(iox2.ServiceName.new(name))
        self._listener = scanloop._retry(lambda: events.event().open()).listener_builder().create()

    def take(self):
        """The oldest sample that was not taken, or None."""
        if not self._kept:
            self._poll()
        return self._hand_over(0) if self._kept else None

    def newest(self, scan):
        """The newest sample, in lock-step that of a scan up to `scan`, which is waited for there; or None."""
        self._await(scan)
        wanted = [at for at, sample in enumerate(self._kept) if not self._member.simulated or sample.header.scan_id <= scan]
        return self._hand_over(wanted[-1]) if wanted else None

    def by_scan(self, scan):
        """The sample of one scan, which lock-step waits for; or None."""
        self._await(scan)
        wanted = [at for at, sample in enumerate(self._kept) if sample.header.scan_id == scan]
        return self._hand_over(wanted[-1]) if wanted else None

    def _hand_over(self, at):
        for _ in range(at):
            self._kept.popleft()
        sample = self._kept.popleft()
        self._port.settle("replaced", at)
        self._port.settle("used")
        if not self._member.simulated:
            self._port.delayed(self._published_ns(sample))
        self._port.show(self._kept)
        self._member.take(sample.header, self._is_first)
        return sample

    def _published_ns(self, sample):
        if self._source is not None:
            return sample.stage.published_ns
        writer = next((role for role, topics in types.WRITES.items() if self._sample in topics), None)
        return 0 if writer is None else sample.header.chain[writer].published_ns

    def _await(self, scan):
        member = self._member
        while True:
            answered = member.simulated and self._answered(scan)
            self._poll()
            done = answered or (self._source is None and self._kept and self._kept[-1].header.scan_id >= scan)
            if not member.simulated or done or not member.is_waited_for() or member.is_over():
                return
            time.sleep(LOCKSTEP_POLL_S)

    def _answered(self, scan):
        if self._source == OPERATOR:
            return True
        if not isinstance(self._source, int):
            return False
        *_, report, holds = self._member.page.right(self._source)
        return holds == 0 or self._member.page.answered_scan(report) >= scan

    def _poll(self):
        while scanloop.Process._listen(self._listener.try_wait):
            pass
        count = 0
        while count < 4 * self._depth and (received := self._subscriber.receive()) is not None:
            count += 1
            sample = self._sample.from_buffer_copy(received.payload().contents)
            received.delete()
            self._arrive(sample)
        queue = self._depth if self._source is not None else QUEUE
        self._member.counters["missed"] += self._port.polled(self._kept, count >= queue)

    def _arrive(self, sample):
        header, counters = sample.header, self._member.counters
        numbers = memoryview(sample).cast("B").cast("d")
        if header.layout != self._sample.LAYOUT:
            self._port.settle("unreadable")
            counters["invalid"] += 1
            return
        if not self._port.arrive(header):
            return
        if any(not abs(numbers[at]) < float("inf") for at in self._numbers):
            self._port.settle("invalid")
            counters["invalid"] += 1
            return
        writer = self._source if self._source is not None else self._role_place()
        if isinstance(writer, int):
            incarnation, previous, from_scan, *_ = self._member.page.right(writer)
            counts = incarnation if header.scan_id >= from_scan else previous
            if counts == 0 or counts != header.incarnation:
                self._port.settle("foreign")
                counters["foreign"] += 1
                return
        if len(self._kept) == self._depth:
            self._kept.popleft()
            self._port.settle("replaced")
        self._kept.append(sample)

    def _role_place(self):
        writer = next((role for role, topics in types.WRITES.items() if self._sample in topics), None)
        return None if writer is None else Page.ROLES_AT + writer * Page.RIGHT


class Writer:
    """Writes a topic of your own."""

    def __init__(self, member, name, sample):
        self._member, self._sample, self._sequence = member, sample, 0
        self._port = Port(member, name, Port.WRITES)
        service = member.node.service_builder(iox2.ServiceName.new(name))
        builder = scanloop._retry(lambda: service.publish_subscribe(sample).open()).publisher_builder()
        builder = builder.max_loaned_samples(1)
        self._publisher = builder.backpressure_strategy(iox2.BackpressureStrategy.DiscardData).create()
        events = member.node.service_builder(iox2.ServiceName.new(name))
        self._notifier = scanloop._retry(lambda: events.event().open()).notifier_builder().create()

    def publish(self, sample):
        """Completes header and stamps of `sample`, publishes a copy of it and wakes its readers."""
        member, now = self._member, self._member.now_ns()
        self._sequence += 1
        header = sample.header
        header.layout, header.incarnation, header.sequence = self._sample.LAYOUT, member.incarnation, self._sequence
        sample.stage = StageStamps(member.woken_ns, member.taken_ns, now, now)
        self._publisher.loan_uninit().write_payload(sample).send()
        if not member.simulated:
            self._port.delayed(header.chain[Role.ROBOT].published_ns)
        self._port.published(self._sequence)
        member.counters["published"] += 1
        member.counters["published_ns"] = time.monotonic_ns()
        member.write()
        try:
            self._notifier.notify()
        except iox2.NotifierNotifyError:
            pass  # a reader that can't be notified finds the sample at its next timeout


def open_topic(process, name, sample):
    """Opens a topic that `also_reads` gives to a process of the loop, before its start()."""
    role = process.role.name.lower()
    member = Member(process._node, process.directory, os.environ["SCANLOOP_RUN_ID"], process.incarnation, role)
    also = [row for row in member.table.get("also_reads", []) if (row["role"], row["topic"]) == (role, name)]
    if not also:
        scanloop._refuse(f"role {role} does not read topic {name} by the system file")
    return _reader(member, name, sample)


def _reader(member, name, sample):
    row = member.row(name)
    _verify(member, name, sample)
    names = member.companions()
    writer = row["writer"]
    source = OPERATOR if writer not in names else Page.COMPANIONS_AT + names.index(writer) * Page.RIGHT
    return Reader(member, name, sample, source, row["queue"])


def _verify(member, name, sample):
    rows = []

    def add(around, start, structure):
        for field, kind in structure._fields_:
            offset, count = start + getattr(structure, field).offset, 1
            if issubclass(kind, ctypes.Array):
                kind, count = kind._type_, kind._length_
            rows.append((name, around + field, types._KINDS.get(kind, kind.__name__), count, ctypes.sizeof(kind), offset))
            if issubclass(kind, ctypes.Structure):
                add(around + field + ".", offset, kind)

    rows.append((name, ".", sample.__name__, 1, ctypes.sizeof(sample), 0))
    add("", 0, sample)
    if found := scanloop.difference(rows, member.layouts, [name]):
        scanloop._refuse(f"built against another layout: {found}; make it again with `scanloop types --python --layout`")


class Companion:
    """A process beside the loop."""

    def __init__(self):
        names = ("SCANLOOP_COMPANION", "SCANLOOP_REPORT", "SCANLOOP_INCARNATION", "SCANLOOP_RUN_ID", "SCANLOOP_DIRECTORY")
        name, report, incarnation, run_id, directory = (os.environ.get(variable) for variable in names)
        if not name or not report or not incarnation or not run_id or not directory:
            scanloop._refuse("companions are started by `scanloop run`")
        with open(f"{directory}/own-topics.toml", "rb") as file:
            index = [row["name"] for row in tomllib.load(file)["companion"]].index(name)
        node = _join_bus(run_id, name)
        self._member = Member(node, directory, run_id, int(incarnation), name, index, int(report))
        self._ended, self._readers, self._first = False, [], None
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._end)

    def input(self, sample):
        """Opens a topic of the loop for reading."""
        if sample.TOPIC not in self._row()["reads"]:
            scanloop._refuse(f"companion {self._member.name} does not read topic {sample.TOPIC} by the system file")
        return self._add(sample.TOPIC, Reader(self._member, sample.TOPIC, sample, None, 64))

    def open(self, name, sample):
        """Opens a topic of your own, for reading or writing as the system file says."""
        row = self._row()
        if name in row["reads"]:
            return self._add(name, _reader(self._member, name, sample))
        if name not in row["writes"]:
            scanloop._refuse(f"companion {self._member.name} neither reads nor writes topic {name} by the system file")
        self._member.row(name)
        _verify(self._member, name, sample)
        return Writer(self._member, name, sample)

    def start(self):
        """Waits until the system drives; False when asked to end."""
        member = self._member
        self._enter(ProcessState.ATTACHED)
        while not self._ended and not member.is_orphan():
            phase = member.page.phase()
            if phase >= Phase.CONNECTING:
                for reader in self._readers:
                    reader._poll()
                self._enter(ProcessState.CONNECTED)
            if phase >= Phase.DRIVING:
                return True
            self._turn()
            time.sleep(0.002)
        return False

    def wait(self, longest_ns=MAX_WAIT_NS):
        """Sleeps until a sample of the first topic may have come; False when asked to end."""
        member = self._member
        member.finish()
        if self._first is None:
            time.sleep(min(longest_ns, MAX_WAIT_NS) * 1e-9)
        else:
            limit = iox2.Duration.from_nanos(max(1, min(longest_ns, MAX_WAIT_NS)))
            scanloop.Process._listen(lambda: self._first._listener.timed_wait(limit))
            self._first._poll()
        member.woken_ns = member.taken_ns = member.now_ns()
        self._turn()
        return not self._ended and not member.is_orphan()

    def _row(self):
        return self._member.table["companion"][self._member.index]

    def _add(self, name, reader):
        self._readers.append(reader)
        if self._member.is_first(name):
            self._first = reader
        return reader

    def _turn(self):
        member = self._member
        member.counters["activations"] += 1
        if member.state == ProcessState.CONNECTED and member.counters["published"] + member.counters["answered"]:
            member.state = ProcessState.READY
        member.write()

    def _enter(self, state):
        self._member.state = state
        self._member.write()

    def _end(self, *_):
        self._ended = True


def _join_bus(run_id, name):
    iox2.set_log_level_from_env_or(iox2.LogLevel.Fatal)
    config, prefix = iox2.config.default(), f"scanloop-{run_id}"
    config.global_cfg.prefix = iox2.FileName.new(f"{prefix}_")
    config.global_cfg.root_path = iox2.Path.new(f"/dev/shm/{prefix}")
    builder = iox2.NodeBuilder.new().name(iox2.NodeName.new(name)).config(config)
    return builder.signal_handling_mode(iox2.SignalHandlingMode.Disabled).create(iox2.ServiceType.Ipc)
