"""A process's place in a run, for any role: its environment, its topics, its signs of life, and how it waits.

What is kept to here is described in ipc_types/CONTRACT.md: "Joining a run", "Topics" and "Waking".
"""

import ctypes
import os
import signal
import sys
import time
import tomllib
from types import SimpleNamespace

import iceoryx2 as iox2

from pathtune_messages import TOPICS, Attempt, BatchHeader, Status

now_ns = time.monotonic_ns
# Who has waited this long may sleep; who wrote longer ago must wake its readers. Both sides count on it.
SLEEPS_AFTER_NS = 100_000
YIELDS = 64
NAP_NS = 20_000_000
BEAT_NS = 90_000_000


def give_up(why):
    """Ends by the user's mistake."""
    print(f"{os.path.basename(sys.argv[0])}: {why}", file=sys.stderr)
    sys.exit(64)


def named(value):
    """Tables as objects: `config.vehicle.wheelbase_m`."""
    if isinstance(value, dict):
        return SimpleNamespace(**{key: named(it) for key, it in value.items()})
    return value


class Run:
    """The run that the environment names."""

    def __init__(self):
        env = os.environ
        if "PATHTUNE_RUN" not in env:
            give_up("PATHTUNE_RUN is not set: start it by `pathtune train lane_change --replace vehicle='…'`")
        self.number = int(env["PATHTUNE_RUN"], 16)
        self.incarnation = int(env["PATHTUNE_INCARNATION"])
        self.max_len = int(env["PATHTUNE_MAX_LEN"])
        with open(os.path.join(env["PATHTUNE_FOLDER"], "config.toml"), "rb") as file:
            self.config = named(tomllib.load(file))

        config = iox2.config.default()
        config.global_cfg.root_path = iox2.Path.new(env["PATHTUNE_ROOT"])
        config.global_cfg.prefix = iox2.FileName.new(env["PATHTUNE_PREFIX"])
        # The orchestrator alone cleans up behind the dead.
        config.global_cfg.node.cleanup_dead_nodes_on_creation = False
        config.global_cfg.node.cleanup_dead_nodes_on_destruction = False
        config.global_cfg.service.cleanup_dead_nodes_on_open = False
        self.node = (
            iox2.NodeBuilder.new()
            .config(config)
            .signal_handling_mode(iox2.SignalHandlingMode.Disabled)
            .create(iox2.ServiceType.Ipc)
        )

    def topic(self, topic):
        name = iox2.ServiceName.new(topic.name)
        builder = self.node.service_builder(name).publish_subscribe(iox2.Slice[topic.element])
        return builder.user_header(topic.header).open()

    def event(self, name):
        return self.node.service_builder(iox2.ServiceName.new(name)).event().open()


class Inlet:
    """Messages of one topic: `receive` copies the oldest into `header` and the first `len` of `items`."""

    def __init__(self, run, name):
        topic = TOPICS[name]
        self.subscriber = run.topic(topic).subscriber_builder().buffer_size(topic.buffer).create()
        self.header = topic.header()
        self.elements = (topic.element * run.max_len)()
        self.items = list(self.elements)  # windows into it, made once
        self.size = ctypes.sizeof(topic.element)
        self.len = 0

    def receive(self):
        sample = self.subscriber.receive()
        if sample is None:
            return False
        # Slice.len() answers bytes; the header knows the elements.
        self.len = sample.header.number_of_elements
        ctypes.memmove(ctypes.addressof(self.header), sample.user_header_ptr, ctypes.sizeof(self.header))
        length = min(self.len, len(self.items)) * self.size
        ctypes.memmove(ctypes.addressof(self.elements), sample.payload_ptr, length)
        return True


class Outlet:
    """The right to send on one topic: fill `header` and `items`, then `send`."""

    def __init__(self, run, name):
        topic = TOPICS[name]
        builder = run.topic(topic).publisher_builder()
        self.publisher = builder.initial_max_slice_len(run.max_len).max_loaned_samples(1).create()
        self.notifiers = [run.event(event).notifier_builder().create() for event in topic.wakes]
        self.header = topic.header()
        self.elements = (topic.element * run.max_len)()
        self.items = list(self.elements)  # windows into it, made once
        self.size = ctypes.sizeof(topic.element)
        self.last_send_ns = 0

    def send(self, count, wakes=True):
        before_ns = now_ns()
        sample = self.publisher.loan_slice_uninit(count)
        ctypes.memmove(sample.user_header_ptr, ctypes.addressof(self.header), ctypes.sizeof(self.header))
        ctypes.memmove(sample.payload_ptr, ctypes.addressof(self.elements), count * self.size)
        sample.assume_init().send()
        if wakes and now_ns() - self.last_send_ns >= SLEEPS_AFTER_NS:
            for notifier in self.notifiers:
                notifier.notify()
        self.last_send_ns = before_ns


def serve(run, role, event, service):
    """Runs `service` until the process is asked to stop.

    `service.poll()` takes at most one step and tells whether there was anything to do; `service.due_ns()` is when it
    wants to be asked again, or None; `service.status` is filled by it; `service.outlets` are its own.
    """
    stop = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.append(1))
    listener = run.event(event).listener_builder().create()
    # Not the listener's own timed wait: the socket beneath counts in the kernel's ticks of a few milliseconds, and would
    # wake a vehicle so late that it leaves ticks out.
    builder = iox2.WaitSetBuilder.new().signal_handling_mode(iox2.SignalHandlingMode.Disabled)
    alarm = builder.create(iox2.ServiceType.Ipc)
    attached = alarm.attach_notification(listener)  # for as long as this is held
    beat = Outlet(run, "status")
    beat.header = BatchHeader(attempt=Attempt(run=run.number))
    status = service.status
    status.role, status.state, status.incarnation = role, Status.READY, run.incarnation
    in_vain, since_ns, is_time, polls = 0, 0, False, 0
    while not stop:
        polls += 1
        look = polls % 256 == 0
        if service.poll():
            in_vain, is_time = 0, False
            os.sched_yield()
        else:
            in_vain += 1
            now = now_ns()
            if in_vain == 1:
                since_ns = now
            if is_time:
                due_ns = service.due_ns()
                nap_ns = NAP_NS if due_ns is None else min(NAP_NS, due_ns - now)
                # The wait takes whole microseconds.
                if nap_ns > 10_000:
                    meet_readers(service.outlets, beat)
                    try:
                        alarm.wait_and_process_with_timeout(iox2.Duration.from_nanos(nap_ns))
                        listener.try_wait()
                    except (iox2.WaitSetRunError, iox2.ListenerWaitError):
                        pass  # a signal, most likely; whatever it was, the next look tells
                look = True
            else:
                # Only the next look counts: a message may have come behind this one.
                is_time = in_vain >= YIELDS and now - since_ns >= SLEEPS_AFTER_NS
                os.sched_yield()
        now = now_ns()
        if look:
            meet_readers(service.outlets, beat)
        if now - beat.last_send_ns >= BEAT_NS:
            beat.header.sent_ns = now
            beat.elements[0] = status
            # Only the first one is waited for.
            beat.send(1, wakes=beat.last_send_ns == 0)


def meet_readers(outlets, beat):
    """A publisher meets a late reader, and hands it its history, only when told to look."""
    for outlet in outlets:
        outlet.publisher.update_connections()
    beat.publisher.update_connections()
