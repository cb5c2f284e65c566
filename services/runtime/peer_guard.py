"""Disconnects peers that would take a service's memory or files, which libzmq does not do itself.

libzmq limits one part (ZMQ_MAXMSGSIZE) and counts whole messages in its queues (ZMQ_RCVHWM): the parts of a message that never ends are
kept in memory and never delivered. It accepts connections as long as there are files. So a thread looks at the connections that libzmq's
monitors report, several times a second, and shuts down those past a limit: libzmq then frees all that the peer has sent. proto/README.md
has the limits in words.
"""

import contextlib
import ctypes
import itertools
import math
import os
import threading
import time
import traceback
from collections import deque
from pathlib import Path
from typing import Any
from weakref import WeakSet

import zmq
from zmq.utils.monitor import recv_monitor_message

from vemlight.runtime import wire
from vemlight.runtime.channels import QUEUE_FRAMES
from vemlight.runtime.log_lines import LogLines
from vemlight.runtime.open_files import file_limit, peer_limit
from vemlight.runtime.peers import PEERS, WORK, Borrowed, Monitor, Peer, reset

# Between two looks at memory: at the 6 GB/s of ipc it grows by 120 MB meanwhile. 0.01 to 0.03 s would do
PERIOD_S = 0.02
# Between two looks at some peers, 10 us each; when memory has grown by so many bytes since, the next is due at once.
JUDGE_PERIOD_S, LOOKED_AT, SUDDEN_GROWTH = 0.2, 32, 8 * 2**20
CALM_S = 30.0  # memory that has been in use for so long is a service's own; 10 to 100 s would do
# Bytes without a whole message, to a socket that takes requests (100 bytes) and subscriptions (8); 8 to 256 kB would do ...
MAX_UNASKED = 64 * 1024
# ... and to one that takes frames: a queue of the largest arrays, and one on its way in.
MAX_UNFINISHED = (QUEUE_FRAMES + 1) * wire.MAX_PART
# ipc has no count of bytes received, and an empty part of 2 bytes takes 64 bytes of memory: so a peer is cut, too, whose bytes wait again
# and again, none of whose messages ends, while memory grows by so much.
MAX_GROWTH_UNASKED, MAX_GROWTH = 64 * 2**20, 192 * 2**20  # bytes; the second: a queue of pictures of 4096 x 2160 (35 MB) and one more
# By how much memory may grow in a single step, which takes no message: compiling takes 200 MB, a first picture of 640 x 480 under 150 soft
# lights 400. 512 MB to 2 GB would do.
MAX_OWN_GROWTH = 2**30
LOOKS, LOOK_S = 30, 0.0003
# In how many of the looks more bytes wait than a few requests have. libzmq reads requests at once; a frame's bytes wait for a few looks.
BUSY_BYTES = 512
BUSY_LOOKS_UNASKED, BUSY_LOOKS = 2, 8
SEARCH_PERIOD_S = 0.1  # between two such searches: memory grows by a service's own work, too
CROWD = 16  # peers who come at once: the others are let in a moment later, lest libzmq use up the files meanwhile. 8 to 64 would do
TRIM_S = 0.1  # by when libzmq has freed what a peer that was disconnected had sent; 0.05 to 1 s would do
HOLD_S = 2.0  # a disconnected peer's address (ipc: process) is refused for so long, then tried again; 1 to 10 s would do
MAX_HELD = 1024  # such addresses; more are forgotten
PAGE = os.sysconf("SC_PAGE_SIZE")
EVENTS = zmq.EVENT_ACCEPTED | zmq.EVENT_CONNECTED | zmq.EVENT_DISCONNECTED | zmq.EVENT_MONITOR_STOPPED
_numbers = itertools.count()


class PeerGuard(threading.Thread):
    """Watches the sockets of one service."""

    def __init__(self, context: zmq.Context[Any]) -> None:
        super().__init__(name="peers", daemon=True)
        self._context = context
        self._watched: WeakSet[Any] = WeakSet()
        self._new: deque[Monitor] = deque()
        self._monitors: dict[Any, Monitor] = {}  # by where its events come
        self._own: dict[int, Peer] = {}
        self._held_until_s: dict[str, float] = {}
        self._lines = LogLines()
        self._doors: list[Path] = []
        self._memory = self._work_memory = _memory()  # when peers were judged last; when no step ran last
        self._calm_memory, self._search_s = float(self._memory), 0.0
        self._trim_s, self._judge_s = math.inf, 0.0
        self._closed_doors = False
        self._stopped = False
        address = f"inproc://peers-{next(_numbers)}"
        self._wakes, self._wake = context.socket(zmq.PAIR), context.socket(zmq.PAIR)
        self._wakes.linger = self._wake.linger = 0
        self._wakes.bind(address)
        self._poller = zmq.Poller()
        self._poller.register(self._wakes, zmq.POLLIN)
        self._wake.connect(address)
        self.start()

    def watch(self, socket: Any, service: str, accepts: bool, takes_frames: bool, door: Path | None = None) -> None:
        """Watches a socket from before it is bound or connected, until it is closed. `door`: the file that peers open to connect to it."""
        if door:
            self._doors.append(door)
        address = f"inproc://peers-{next(_numbers)}"
        socket.monitor(address, EVENTS)
        self._watched.add(socket)
        events = self._context.socket(zmq.PAIR)
        events.linger = 0
        events.connect(address)
        limits = (MAX_UNFINISHED, MAX_GROWTH, BUSY_LOOKS) if takes_frames else (MAX_UNASKED, MAX_GROWTH_UNASKED, BUSY_LOOKS_UNASKED)
        self._new.append(Monitor(events, service, accepts, *limits))
        self._rouse()

    def _rouse(self) -> None:
        with contextlib.suppress(zmq.Again):  # the thread has ended, or is roused already
            self._wake.send(b"", zmq.NOBLOCK)

    def stop(self) -> None:
        """Ends the thread; nothing is watched any more."""
        for socket in self._watched:  # first: libzmq waits for whoever reads its events
            with contextlib.suppress(zmq.ZMQError):  # closed
                socket.disable_monitor()
        self._stopped = True
        self._rouse()
        self.join()
        self._wake.close()

    def run(self) -> None:
        try:
            self._watch_peers()
        except Exception:  # a service without its guard, whose monitors nobody reads, would stand still
            traceback.print_exc()
            os._exit(1)

    def _watch_peers(self) -> None:
        due_s = 0.0
        while not self._stopped:
            found = self._poller.poll(math.ceil(max(0.0, due_s - time.monotonic()) * 1e3) if self._own else None)
            for events, _ in found:
                if events is self._wakes:
                    self._wakes.recv()
                else:
                    self._take_events(self._monitors[events])
            while self._new:
                new = self._new.popleft()
                self._monitors[new.events] = new
                self._poller.register(new.events, zmq.POLLIN)
            if time.monotonic() >= due_s:
                self._look()
                due_s = time.monotonic() + PERIOD_S
        for peer in list(self._own.values()):
            self._forget(peer)
        for events in [*self._monitors, *(new.events for new in self._new), self._wakes]:
            events.close()
        self._open_doors()

    def _take_events(self, monitor: Monitor) -> None:
        """Notes who came and went. Of a crowd those who are too many are disconnected first, while libzmq goes on to accept."""
        came: list[int] = []
        limit = peer_limit() - sum(peer.monitor.accepts for peer in self._own.values())
        while monitor.events.poll(0):
            event = recv_monitor_message(monitor.events, zmq.NOBLOCK)
            match event["event"]:
                case zmq.EVENT_ACCEPTED | zmq.EVENT_CONNECTED:
                    came.append(event["value"])
                    if monitor.accepts and len(came) == CROWD:
                        self._close_doors()
                    if monitor.accepts and len(came) > limit:
                        self._refuse(came.pop(), monitor)
                case zmq.EVENT_DISCONNECTED:
                    peer = self._own.get(event["value"])
                    if event["value"] in came:
                        came.remove(event["value"])
                    elif peer and peer.monitor is monitor:
                        self._forget(peer)
                case zmq.EVENT_MONITOR_STOPPED:
                    del self._monitors[monitor.events]
                    self._poller.unregister(monitor.events)
                    for peer in [peer for peer in self._own.values() if peer.monitor is monitor]:
                        self._forget(peer)
                    monitor.events.close()
                    return
        for file in came:
            self._add(file, monitor)

    def _refuse(self, file: int, monitor: Monitor) -> None:
        """Disconnects a peer that is one too many."""
        with contextlib.suppress(OSError), Borrowed(file) as connection:
            reset(connection)
        self._lines.say(
            "surplus",
            f"{monitor.service}: refused a peer: {peer_limit()} are connected, as many as a limit of {file_limit()} open files allows; "
            "raise it (ulimit -n, LimitNOFILE=)",
        )

    def _close_doors(self) -> None:
        """Lets nobody else in until the next look."""
        self._closed_doors = True
        for door in self._doors:
            with contextlib.suppress(OSError):
                door.rename(_closed(door))

    def _open_doors(self) -> None:
        self._closed_doors = False
        for door in self._doors:
            if _closed(door).exists():
                _closed(door).rename(door)

    def _add(self, file: int, monitor: Monitor) -> None:
        try:
            peer = Peer(file, monitor)
        except OSError:
            return
        PEERS[file] = self._own[file] = peer
        if monitor.accepts and self._held_until_s.get(peer.name, 0.0) > peer.since_s:
            self._shut_down(peer)

    def _forget(self, peer: Peer) -> None:
        self._own.pop(peer.file, None)
        if PEERS.get(peer.file) is peer:
            del PEERS[peer.file]

    def _look(self) -> None:
        """Judges all peers when memory has grown, or else a few now and then."""
        memory, now_s = _memory(), time.monotonic()
        self._calm_memory = min(float(memory), self._calm_memory + (memory - self._calm_memory) * PERIOD_S / CALM_S)
        if not WORK.is_on:
            self._work_memory = memory
        elif memory - self._work_memory < MAX_OWN_GROWTH:  # a step's own, while frames wait that nobody takes
            self._calm_memory = float(memory)
        grown = memory - self._calm_memory > MAX_GROWTH_UNASKED and now_s > self._search_s
        self._memory = min(self._memory, memory)
        if self._closed_doors:
            self._open_doors()
        if grown or memory - self._memory > SUDDEN_GROWTH or now_s > self._judge_s:
            self._judge_s, self._memory = now_s + JUDGE_PERIOD_S, memory
            for peer in list(self._own.values())[: None if grown else LOOKED_AT]:
                self._own[peer.file] = self._own.pop(peer.file)  # to the end of the row
                self._judge(peer)
        if grown:
            self._search(memory - self._calm_memory)
        if now_s > self._trim_s:
            self._trim_s = math.inf
            _return_memory()

    def _judge(self, peer: Peer) -> None:
        """By what it has sent."""
        try:
            received, waiting = peer.look()
        except OSError:
            self._forget(peer)
            return
        if peer.took:
            peer.took, peer.mark = False, received
        limit = peer.monitor.max_unfinished
        if peer.offence:
            self._end(peer, peer.offence)
        elif received - peer.mark > limit or (peer.monitor.accepts and waiting > limit):
            self._end(peer, f"sent over {limit} bytes of one message")

    def _search(self, growth: float) -> None:
        """Judges by the growth of memory, in bytes, those who send without end."""
        suspects = [peer for peer in self._own.values() if not peer.took and growth > peer.monitor.max_growth]
        if not suspects:
            return
        self._search_s = time.monotonic() + SEARCH_PERIOD_S
        busy = dict.fromkeys(suspects, 0)
        for _ in range(LOOKS):
            for peer in suspects:
                with contextlib.suppress(OSError):
                    busy[peer] += peer.look()[1] > BUSY_BYTES
                if busy[peer] == peer.monitor.busy_looks and not peer.took:
                    self._end(peer, f"sent over {peer.monitor.max_growth} bytes of one message")
            time.sleep(LOOK_S)

    def _end(self, peer: Peer, reason: str) -> None:
        """Disconnects a peer and holds its address."""
        self._lines.say(reason, f"{peer.monitor.service}: disconnected {peer.name}: {reason}")
        if len(self._held_until_s) >= MAX_HELD:
            self._held_until_s.clear()
        self._held_until_s[peer.name] = time.monotonic() + HOLD_S
        self._trim_s = time.monotonic() + TRIM_S
        self._shut_down(peer)

    def _shut_down(self, peer: Peer) -> None:
        with contextlib.suppress(OSError):
            peer.shut_down()
        self._forget(peer)


def _closed(door: Path) -> Path:
    """What a door is called while nobody may enter."""
    return door.with_name(f"{door.name}.full")


def _return_memory() -> None:
    """Gives memory that is free back to the system, where the C library can: it would count as in use."""
    with contextlib.suppress(AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


def _memory() -> int:
    """Bytes of memory of this process's own."""
    with open("/proc/self/statm", "rb", buffering=0) as statm:
        _, resident, shared, *_ = statm.read().split()
    return (int(resident) - int(shared)) * PAGE
