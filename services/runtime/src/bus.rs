//! The bus of one run: topics, the ports on them, and the events that wake their readers.

use std::any::Any;
use std::cell::{Cell, RefCell};
use std::fs;
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::fs::PermissionsExt;
use std::rc::Rc;
use std::time::Duration;

use ::config::MAX_FLEET;
use iceoryx2::config::Config;
use iceoryx2::node::{Node, NodeBuilder};
use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample;
use iceoryx2::sample_mut::SampleMut;
use iceoryx2::service::port_factory::PortFactory as _;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use ipc_types::topics::{MAX_NODES, MAX_SUBSCRIBERS, OBSERVER_BUFFER};
use ipc_types::{Message, WakeRole, for_each_topic};
use rustix::event::{PollFd, PollFlags, poll};
use rustix::time::Timespec;

use crate::chaos::Disturbance;
use crate::clock::now_ns;
use crate::run::RunNames;
use crate::waiting::Wait;

/// The transport refused something; the error says what was requested.
#[derive(Debug, thiserror::Error)]
#[error("failed to {action}: {cause}")]
pub struct BusError {
    action: String,
    cause: String,
}

/// Makes an error that says what was requested; the text is made only if it was refused.
fn refused<E: std::fmt::Debug>(action: impl FnOnce() -> String) -> impl FnOnce(E) -> BusError {
    move |cause| BusError { action: action(), cause: format!("{cause:?}") }
}

/// One process's place on the bus of a run.
pub struct Bus {
    node: Node<ipc::Service>,
    max_len: usize,
    /// Which ring's topics it uses.
    ring: usize,
    wait: Wait,
    /// Held only by the creator, so that topics outlive their users.
    held: Vec<Box<dyn Any>>,
    /// Every publisher of this process: they notice late joiners only when told to look.
    outlets: RefCell<Vec<Rc<dyn LooksForReaders>>>,
}

trait LooksForReaders {
    fn look_for_readers(&self);
}

impl<M: Message> LooksForReaders for Publisher<ipc::Service, [M], M::Header> {
    fn look_for_readers(&self) {
        let _ = self.update_connections();
    }
}

impl Bus {
    /// Creates the bus of a run with all its topics, and holds them. Only the orchestrator does this.
    ///
    /// # Errors
    /// If the transport refuses, for example because `/dev/shm` is full.
    pub fn create(names: &RunNames, max_len: usize) -> Result<Self, BusError> {
        let bus = Self::attach(names, max_len)?;
        tighten_global_management(names);
        bus.with_topics()
    }

    /// Creates the topics of a further ring of the run, counted from 0, and holds them; the events of orchestrator, trainer and
    /// recorder are those of the run's first bus.
    ///
    /// # Errors
    /// As [`Bus::create`].
    pub fn create_ring(names: &RunNames, max_len: usize, ring: usize) -> Result<Self, BusError> {
        Self::attach(names, max_len)?.in_ring(ring).with_topics()
    }

    fn with_topics(self) -> Result<Self, BusError> {
        let mut bus = self;
        let mut held: Vec<Box<dyn Any>> = Vec::new();
        macro_rules! create {
            ($message:ty) => {
                held.push(Box::new(bus.topic::<$message>(true)?));
            };
        }
        for_each_topic!(create);
        for role in WakeRole::ALL.into_iter().filter(|role| bus.ring == 0 || role.is_of_ring()) {
            let event = bus
                .node
                .service_builder(&bus.event_name(role))
                .event()
                .max_listeners(16)
                .max_notifiers(MAX_NODES)
                .max_nodes(MAX_NODES)
                .event_id_max_value(0)
                .create()
                .map_err(refused(|| format!("create the event {}", role.event_name())))?;
            held.push(Box::new(event));
        }
        bus.held = held;
        Ok(bus)
    }

    /// Joins the bus of a run. `max_len` is the largest number of elements that a message will carry.
    ///
    /// # Errors
    /// If the run is gone or the transport refuses.
    pub fn attach(names: &RunNames, max_len: usize) -> Result<Self, BusError> {
        let node = NodeBuilder::new()
            .config(&transport_config(names)?)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<ipc::Service>()
            .map_err(refused(|| "join the run".to_owned()))?;
        Ok(Self {
            node,
            max_len,
            ring: 0,
            wait: Wait::default(),
            held: Vec::new(),
            outlets: RefCell::default(),
        })
    }

    /// The same bus, if the readers of the run wait in another way than by default.
    pub fn waiting(self, wait: Wait) -> Self {
        Self { wait, ..self }
    }

    /// The same bus with the topics of another ring.
    pub(crate) fn in_ring(self, ring: usize) -> Self {
        Self { ring, ..self }
    }

    fn topic_name<M: Message>(&self) -> ServiceName {
        service_name(M::TOPIC.name, self.ring)
    }

    /// Who serves all rings is woken by one event.
    fn event_name(&self, role: WakeRole) -> ServiceName {
        service_name(role.event_name(), if role.is_of_ring() { self.ring } else { 0 })
    }

    fn topic<M: Message>(
        &self,
        create: bool,
    ) -> Result<PortFactory<ipc::Service, [M], M::Header>, BusError> {
        let topic = M::TOPIC;
        let builder = self
            .node
            .service_builder(&self.topic_name::<M>())
            .publish_subscribe::<[M]>()
            .user_header::<M::Header>();
        if create {
            builder
                .history_size(topic.history)
                .subscriber_max_buffer_size(OBSERVER_BUFFER)
                .subscriber_max_borrowed_samples(2)
                .max_subscribers(MAX_SUBSCRIBERS)
                .max_publishers(topic.publishers)
                .max_nodes(MAX_NODES)
                // A reader that stalls loses its own samples; it never stops the loop.
                .enable_safe_overflow(true)
                .create()
                .map_err(refused(|| format!("create the topic {}", topic.name)))
        } else {
            builder.open().map_err(refused(|| format!("open the topic {}", topic.name)))
        }
    }

    /// The right to send messages of one kind.
    ///
    /// # Errors
    /// If another process has it, or the transport refuses.
    pub fn outlet<M: Message>(&self) -> Result<Outlet<M>, BusError> {
        let topic = self.topic::<M>(false)?;
        let publisher = topic
            .publisher_builder()
            .initial_max_slice_len(self.max_len)
            .max_loaned_samples(1)
            .create()
            .map_err(refused(|| format!("publish on {}", M::TOPIC.name)))?;
        let publisher = Rc::new(publisher);
        self.outlets.borrow_mut().push(publisher.clone());
        let wakes =
            M::TOPIC.wakes.iter().map(|role| self.notifier(*role)).collect::<Result<_, _>>()?;
        let disturbance = Disturbance::from_env(M::TOPIC.name);
        let sleeps_after_ns = self.wait.sleeps_after_ns();
        Ok(Outlet {
            topic,
            publisher,
            wakes,
            sleeps_after_ns,
            last_send_ns: Cell::new(0),
            disturbance,
        })
    }

    /// The right to receive messages of one kind, as a participant.
    ///
    /// # Errors
    /// If the transport refuses.
    pub fn inlet<M: Message>(&self) -> Result<Inlet<M>, BusError> {
        self.inlet_with_buffer(M::TOPIC.buffer)
    }

    /// The right to receive messages of one kind, as an observer that may lag behind.
    ///
    /// # Errors
    /// If the transport refuses.
    pub fn observe<M: Message>(&self) -> Result<Inlet<M>, BusError> {
        self.inlet_with_buffer(OBSERVER_BUFFER)
    }

    /// Checks whether a process that takes the elements of `M`'s topic for `T`s could connect: only if name, hash of
    /// the layout, size and alignment are the same.
    ///
    /// # Errors
    /// If the transport refuses, as it should for every other type.
    pub fn open_as<M: Message, T: Message>(&self) -> Result<(), BusError> {
        self.node
            .service_builder(&self.topic_name::<M>())
            .publish_subscribe::<[T]>()
            .user_header::<M::Header>()
            .open()
            .map(|_| ())
            .map_err(refused(|| format!("open the topic {}", M::TOPIC.name)))
    }

    fn inlet_with_buffer<M: Message>(&self, buffer: usize) -> Result<Inlet<M>, BusError> {
        let subscriber = self
            .topic::<M>(false)?
            .subscriber_builder()
            .buffer_size(buffer)
            .create()
            .map_err(refused(|| format!("subscribe to {}", M::TOPIC.name)))?;
        Ok(Inlet { subscriber })
    }

    fn notifier(&self, role: WakeRole) -> Result<Notifier<ipc::Service>, BusError> {
        self.node
            .service_builder(&self.event_name(role))
            .event()
            .open()
            .map_err(refused(|| format!("open the event {}", role.event_name())))?
            .notifier_builder()
            .create()
            .map_err(refused(|| format!("notify on {}", role.event_name())))
    }

    /// What wakes this process, in its role.
    ///
    /// # Errors
    /// If the transport refuses.
    pub fn alarm(&self, role: WakeRole) -> Result<Alarm, BusError> {
        let listener = self
            .node
            .service_builder(&self.event_name(role))
            .event()
            .open()
            .map_err(refused(|| format!("open the event {}", role.event_name())))?
            .listener_builder()
            .create()
            .map_err(refused(|| format!("listen on {}", role.event_name())))?;
        Ok(Alarm { listener })
    }

    /// Lets every publisher of this process notice readers that have joined since, and pass its history to them.
    pub fn look_for_readers(&self) {
        for outlet in self.outlets.borrow().iter() {
            outlet.look_for_readers();
        }
    }

    /// Removes what dead processes of the run left on the bus. May hang on half-made files: only for a
    /// process that will be killed if it hangs.
    pub fn clean_dead_nodes(&self) {
        self.node.blocking_cleanup_dead_nodes(Duration::from_millis(500));
    }
}

/// What wakes a process that sleeps.
#[derive(Debug)]
pub struct Alarm {
    listener: Listener<ipc::Service>,
}

impl Alarm {
    /// Sleeps until another process notifies, or for `at_most`. May also return for no reason.
    pub fn wait(&self, at_most: Duration) {
        let Ok(at_most) = Timespec::try_from(at_most) else { return };
        // Not the listener's own timed wait: a socket's timeout is counted in the kernel's ticks of a few
        // milliseconds, and a process that paces by the clock would be late by as much.
        if let Ok(1) = poll(&mut [PollFd::new(self, PollFlags::IN)], Some(&at_most)) {
            self.clear();
        }
    }

    /// Discards the notifications that have come.
    pub fn clear(&self) {
        let _ = self.listener.try_wait(|_| {});
    }
}

impl AsFd for Alarm {
    /// Readable when another process notifies.
    fn as_fd(&self) -> BorrowedFd<'_> {
        // SAFETY: the descriptor is the listener's, which lives as long as the borrow.
        #[allow(unsafe_code)]
        unsafe {
            BorrowedFd::borrow_raw(self.listener.file_descriptor().native_handle())
        }
    }
}

/// The right to send messages of one kind.
pub struct Outlet<M: Message> {
    topic: PortFactory<ipc::Service, [M], M::Header>,
    publisher: Rc<Publisher<ipc::Service, [M], M::Header>>,
    wakes: Vec<Notifier<ipc::Service>>,
    /// After how long without a message its readers may sleep.
    sleeps_after_ns: u64,
    last_send_ns: Cell<u64>,
    disturbance: Option<Disturbance>,
}

impl<M: Message> Outlet<M> {
    /// Whether there is a reader: a topic that only observers read costs nothing without one.
    pub fn has_readers(&self) -> bool {
        self.topic.dynamic_config().number_of_subscribers() > 0
    }

    /// Sends one message of `len` elements, each written in place by `write`, and wakes its readers if
    /// they may sleep.
    ///
    /// Readers sleep only after a certain time without a message, which is the same for the whole run. If the previous
    /// message is younger than that even now, after this send, they have not slept in between, and will find this
    /// message.
    ///
    /// # Errors
    /// If the transport refuses.
    pub fn send(
        &self,
        header: M::Header,
        len: usize,
        write: impl FnMut(usize) -> M,
    ) -> Result<(), BusError> {
        self.write(len, write)?.send(|_| header)
    }

    /// Writes one message of `len` elements in place, to be sent afterwards: computing the elements may be
    /// the work of the tick.
    ///
    /// # Errors
    /// If the transport refuses.
    pub fn write(
        &self,
        len: usize,
        write: impl FnMut(usize) -> M,
    ) -> Result<Written<'_, M>, BusError> {
        let sample = self
            .publisher
            .loan_slice_uninit(len)
            .map_err(refused(|| format!("loan {len} elements of {}", M::TOPIC.name)))?;
        Ok(Written { outlet: self, sample: sample.write_from_fn(write) })
    }

    /// As [`Outlet::send`], without waking the readers.
    ///
    /// # Errors
    /// If the transport refuses.
    pub fn send_quietly(
        &self,
        header: M::Header,
        len: usize,
        write: impl FnMut(usize) -> M,
    ) -> Result<(), BusError> {
        self.write(len, write)?.publish(header)
    }
}

/// A message in shared memory that is written but not sent yet; if dropped, it is never sent.
pub struct Written<'a, M: Message> {
    outlet: &'a Outlet<M>,
    sample: SampleMut<ipc::Service, [M], M::Header>,
}

impl<M: Message> Written<'_, M> {
    /// Sends it with the header that is made from the current time, and wakes its readers if they may sleep: see
    /// [`Outlet::send`].
    ///
    /// # Errors
    /// If the transport refuses.
    pub fn send(self, header: impl FnOnce(u64) -> M::Header) -> Result<(), BusError> {
        let outlet = self.outlet;
        let before_ns = now_ns();
        self.publish(header(before_ns))?;
        if now_ns() - outlet.last_send_ns.replace(before_ns) >= outlet.sleeps_after_ns {
            for notifier in &outlet.wakes {
                // It is not an error if nobody is listening.
                let _ = notifier.notify();
            }
        }
        Ok(())
    }

    fn publish(mut self, header: M::Header) -> Result<(), BusError> {
        if self.outlet.disturbance.as_ref().is_some_and(Disturbance::swallows) {
            return Ok(());
        }
        *self.sample.user_header_mut() = header;
        self.sample.send().map_err(refused(|| format!("send on {}", M::TOPIC.name)))?;
        Ok(())
    }
}

/// The right to receive messages of one kind.
pub struct Inlet<M: Message> {
    subscriber: Subscriber<ipc::Service, [M], M::Header>,
}

impl<M: Message> Inlet<M> {
    /// The oldest message that has not been taken yet.
    ///
    /// A message with more elements than any of ours has is passed over unread: its sender is no process of this run, and
    /// whoever looked at all of it would stand still meanwhile.
    ///
    /// # Errors
    /// If the transport refuses.
    pub fn receive(&self) -> Result<Option<Received<M>>, BusError> {
        // As many at a time as can wait: nobody can keep us here.
        for _ in 0..OBSERVER_BUFFER {
            let sample = self
                .subscriber
                .receive()
                .map_err(refused(|| format!("receive from {}", M::TOPIC.name)))?;
            let Some(sample) = sample else { return Ok(None) };
            if sample.payload().len() <= MAX_FLEET {
                return Ok(Some(Received { sample }));
            }
            tracing::debug!(topic = M::TOPIC.name, len = sample.payload().len(), "too long");
        }
        Ok(None)
    }

    /// The newest message; older ones are dropped.
    ///
    /// # Errors
    /// If the transport refuses.
    pub fn receive_newest(&self) -> Result<Option<Received<M>>, BusError> {
        let mut newest = None;
        while let Some(received) = self.receive()? {
            newest = Some(received);
        }
        Ok(newest)
    }
}

/// A message in shared memory, read in place; when it is dropped, the sender may reuse its memory.
pub struct Received<M: Message> {
    sample: Sample<ipc::Service, [M], M::Header>,
}

impl<M: Message> Received<M> {
    /// The message's header.
    pub fn header(&self) -> M::Header {
        *self.sample.user_header()
    }

    /// The message's elements.
    pub fn items(&self) -> &[M] {
        self.sample.payload()
    }
}

/// The name of a topic or event; the first ring's are those of `CONTRACT.md`.
fn service_name(name: &str, ring: usize) -> ServiceName {
    let name = match ring {
        0 => name.to_owned(),
        ring => format!("ring_{}/{name}", ring + 1),
    };
    ServiceName::new(&name).expect("topic names are short and not empty")
}

/// The configuration of a run as text, for programs that know iceoryx2 and nothing of us, such as its own command line.
///
/// # Errors
/// If the run has a folder whose path iceoryx2 cannot use.
pub fn iox2_config(names: &RunNames) -> Result<String, BusError> {
    let config = transport_config(names)?;
    toml::to_string(&config).map_err(refused(|| "write the configuration".to_owned()))
}

fn transport_config(names: &RunNames) -> Result<Config, BusError> {
    let mut config = Config::default();
    let global = &mut config.global;
    global.prefix =
        FileName::new(names.prefix().as_bytes()).map_err(refused(|| "name the run".to_owned()))?;
    let root = Path::new(names.root.as_os_str().as_encoded_bytes())
        .map_err(refused(|| format!("use the folder {}", names.root.display())))?;
    global.set_root_path(&root);
    // Only the orchestrator cleans up, in a helper process, because the clean-up may hang on half-made files.
    global.node.cleanup_dead_nodes_on_creation = false;
    global.node.cleanup_dead_nodes_on_destruction = false;
    global.service.cleanup_dead_nodes_on_open = false;
    Ok(config)
}

/// The transport creates its management segment open to all users; this closes it to the others.
fn tighten_global_management(names: &RunNames) {
    for name in crate::run::segments_of(names.run) {
        if name.ends_with(".global_mgmt") {
            let path = std::path::Path::new("/dev/shm").join(name);
            let _ = fs::set_permissions(path, fs::Permissions::from_mode(0o600));
        }
    }
}
