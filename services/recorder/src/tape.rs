//! The file: channels, chunks, rotation. A separate thread writes it, because a disk may be slow, and the
//! recorder has to give signs of life meanwhile.

use std::collections::{BTreeMap, HashMap};
use std::fs::{self, File, OpenOptions};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow};
use ipc_types::layout::Bytes;
use ipc_types::{BatchHeader, DriveRequest, has};
use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, Compression, WriteOptions, Writer};

use crate::raw;
use crate::ros::{Kind, RosMessage, Teller};
use crate::rosbag;
use crate::timeline::{Timeline, WallClock};
use crate::topics::{Sample, TopicInfo, index_of, topics};

/// Name of the metadata record at a file's beginning.
pub const BEGINNING: &str = "pathtune";
/// Name of the metadata record at the end of a file that was ended in order.
pub const END: &str = "pathtune.end";

/// A chunk is closed at this size, before compression.
const CHUNK_BYTES: u64 = 1 << 20;
/// A chunk is closed at this age: a `kill -9` may cost that much, and a little more for the disk.
const CHUNK_AGE: Duration = Duration::from_millis(800);
/// How many bytes of messages may wait for the disk. By the clock nothing waits for the recorder: at 100 Hz a car's run
/// fills this in about three minutes.
const QUEUE_BYTES: usize = 32 << 20;

/// The settings of a recording's files.
#[derive(Debug, Clone)]
pub(crate) struct Settings {
    /// The first file; further ones are numbered.
    pub(crate) files: Files,
    pub(crate) tick_s: f64,
    /// The path that is driven; `None` if the vehicle follows none.
    pub(crate) path: Option<tracking::Path>,
    pub(crate) wall: WallClock,
    /// The run is to be driven in real time.
    pub(crate) by_the_clock: bool,
    /// The metadata at the beginning of each file.
    pub(crate) beginning: BTreeMap<String, String>,
    /// Files that are attached to each file: their names and contents.
    pub(crate) attachments: Vec<(String, Vec<u8>)>,
}

/// The names of a recording's files.
#[derive(Debug, Clone)]
pub(crate) struct Files {
    /// The name without number and extension.
    stem: PathBuf,
    /// Size at which the next file begins.
    split_bytes: Option<u64>,
    /// Number of the file that is being written, counted from 1.
    pub(crate) number: u32,
}

impl Files {
    /// The files beginning with the first one that does not exist yet.
    pub(crate) fn first_free(stem: PathBuf, split_bytes: Option<u64>) -> Self {
        let mut files = Self { stem, split_bytes, number: 1 };
        while files.path().exists() {
            files.number += 1;
        }
        files
    }

    /// The file that is being written.
    pub(crate) fn path(&self) -> PathBuf {
        self.path_of(self.number)
    }

    fn path_of(&self, number: u32) -> PathBuf {
        let mut name = self.stem.clone().into_os_string();
        match (self.split_bytes, number) {
            (Some(_), _) => name.push(format!("-{number:04}.mcap")),
            (None, 1) => name.push(".mcap"),
            (None, _) => name.push(format!("-{number}.mcap")),
        }
        PathBuf::from(name)
    }

    /// The file before, if there is one.
    pub(crate) fn before(&self) -> Option<PathBuf> {
        (self.number > 1).then(|| self.path_of(self.number - 1))
    }
}

pub(crate) fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// A recording that is being written by a thread.
pub(crate) struct Tape {
    blocks: Option<Sender<Vec<Sample>>>,
    /// Bytes that wait for the thread.
    waiting: Arc<AtomicUsize>,
    thread: Option<JoinHandle<Result<Reel>>>,
}

impl Tape {
    /// Starts a recording.
    ///
    /// # Errors
    /// If its file cannot be created.
    pub(crate) fn start(settings: Settings) -> Result<Self> {
        let reel = Reel::new(settings)?;
        let (blocks, incoming) = channel();
        let waiting = Arc::new(AtomicUsize::new(0));
        let written = waiting.clone();
        let thread = std::thread::Builder::new()
            .name("tape".to_owned())
            .spawn(move || reel.run(&incoming, &written))
            .context("failed to start the writing thread")?;
        Ok(Self { blocks: Some(blocks), waiting, thread: Some(thread) })
    }

    /// Hands samples over, unless the thread is too far behind; then it returns them.
    ///
    /// # Errors
    /// If the file could not be written.
    pub(crate) fn offer(&mut self, block: Vec<Sample>) -> Result<Option<Vec<Sample>>> {
        let Some(blocks) = &self.blocks else { return Ok(None) };
        if self.waiting.load(Ordering::Relaxed) > QUEUE_BYTES {
            return Ok(Some(block));
        }
        self.waiting.fetch_add(bytes_of(&block), Ordering::Relaxed);
        if blocks.send(block).is_err() {
            self.join()?;
            return Err(anyhow!("the recording has ended unexpectedly"));
        }
        Ok(None)
    }

    fn join(&mut self) -> Result<Option<Reel>> {
        self.blocks = None;
        let Some(thread) = self.thread.take() else { return Ok(None) };
        thread.join().map_err(|_| anyhow!("the writing thread has panicked"))?.map(Some)
    }

    /// Writes the rest, and ends the file in order; returns its name.
    pub(crate) fn finish(
        mut self,
        rest: Vec<Sample>,
        end: BTreeMap<String, String>,
    ) -> Result<PathBuf> {
        if let Some(blocks) = &self.blocks {
            self.waiting.fetch_add(bytes_of(&rest), Ordering::Relaxed);
            // The thread may have failed, which the join reports.
            let _ = blocks.send(rest);
        }
        let mut reel = self.join()?.ok_or_else(|| anyhow!("the recording has ended already"))?;
        reel.close(end)?;
        Ok(reel.settings.files.path())
    }
}

/// What a block takes of the queue.
fn bytes_of(block: &[Sample]) -> usize {
    block.iter().map(|sample| size_of::<Sample>() + sample.bytes.len()).sum()
}

/// The thread's part.
struct Reel {
    settings: Settings,
    topics: Vec<TopicInfo>,
    timeline: Timeline,
    teller: Teller,
    writer: Writer<File>,
    file: File,
    /// The channels of our own topics, in their order, with the number of the next message.
    own: Vec<(u16, u32)>,
    /// Number of the topic of requests, which say how the vehicle paces.
    requests: usize,
    /// Room for one wrapped message.
    wrapped: Vec<u8>,
    ros: HashMap<String, (u16, u32)>,
    /// When the open chunk was begun.
    chunk_since: Instant,
    /// Bytes written since the size of the file was last checked.
    unlooked: u64,
}

impl Reel {
    fn new(settings: Settings) -> Result<Self> {
        let topics = topics();
        let (writer, file) = open(&settings)?;
        let mut reel = Self {
            timeline: Timeline::new(settings.tick_s, settings.wall, settings.by_the_clock),
            teller: Teller::new(settings.path.clone()),
            settings,
            topics,
            writer,
            file,
            own: Vec::new(),
            requests: index_of("drive_request"),
            wrapped: Vec::new(),
            ros: HashMap::new(),
            chunk_since: Instant::now(),
            unlooked: 0,
        };
        reel.begin()?;
        Ok(reel)
    }

    /// Writes the beginning of each file, so that each file by itself shows where it comes from.
    fn begin(&mut self) -> Result<()> {
        let mut metadata = self.settings.beginning.clone();
        metadata.insert("file".to_owned(), self.settings.files.number.to_string());
        if let Some(before) = self.settings.files.before() {
            metadata.insert("continues".to_owned(), name_of(&before));
        }
        self.writer.write_metadata(&Metadata { name: BEGINNING.to_owned(), metadata })?;
        for (name, data) in &self.settings.attachments {
            self.writer.attach(&Attachment {
                log_time: 0,
                create_time: 0,
                name: name.clone(),
                media_type: "application/toml".to_owned(),
                data: data.as_slice().into(),
            })?;
        }
        let rosbag2 = Metadata { name: rosbag::RECORD.to_owned(), metadata: rosbag::metadata() };
        self.writer.write_metadata(&rosbag2)?;
        self.own.clear();
        self.ros.clear();
        self.teller.begin_file();
        let schema = self.writer.add_schema(raw::SCHEMA, "ros2msg", raw::DEFINITION.as_bytes())?;
        for topic in &self.topics {
            let metadata = BTreeMap::from([
                ("element".to_owned(), topic.element.to_owned()),
                ("header".to_owned(), topic.header.to_owned()),
                ("layout".to_owned(), topic.layout.clone()),
                (rosbag::QOS.to_owned(), rosbag::qos(false)),
            ]);
            let id = self.writer.add_channel(schema, &topic.channel(), "cdr", &metadata)?;
            self.own.push((id, 0));
        }
        if self.teller.follows_path() {
            self.ros_channel("/path", Kind::Path)?;
        }
        for (topic, kind) in [
            ("/tf", Kind::TfMessage),
            ("/odom", Kind::Odometry),
            ("/truth", Kind::Odometry),
            ("/cmd", Kind::AckermannDriveStamped),
            ("/tracking_error", Kind::Vector3Stamped),
            ("/diagnostics", Kind::DiagnosticArray),
        ] {
            self.ros_channel(topic, kind)?;
        }
        self.writer.flush()?;
        Ok(())
    }

    fn ros_channel(&mut self, topic: &str, kind: Kind) -> Result<u16> {
        let (name, text) = kind.schema();
        let schema = self.writer.add_schema(name, "ros2msg", text.as_bytes())?;
        let qos = BTreeMap::from([(rosbag::QOS.to_owned(), rosbag::qos(kind == Kind::Path))]);
        let id = self.writer.add_channel(schema, topic, "cdr", &qos)?;
        self.ros.insert(topic.to_owned(), (id, 0));
        Ok(id)
    }

    fn run(mut self, incoming: &Receiver<Vec<Sample>>, waiting: &AtomicUsize) -> Result<Self> {
        loop {
            match incoming.recv_timeout(CHUNK_AGE / 8) {
                Ok(block) => {
                    for sample in &block {
                        self.write(sample)?;
                    }
                    waiting.fetch_sub(bytes_of(&block), Ordering::Relaxed);
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return Ok(self),
            }
            if self.chunk_since.elapsed() >= CHUNK_AGE {
                self.writer.flush()?;
                self.chunk_since = Instant::now();
            }
            self.rotate_if_full()?;
        }
    }

    fn write(&mut self, sample: &Sample) -> Result<()> {
        if sample.topic == self.requests {
            self.timeline.pace(is_by_the_clock(&sample.bytes));
        }
        let stamp_ns = self.timeline.stamp(sample.place);
        raw::wrap(&sample.bytes, &mut self.wrapped);
        let (id, sequence) = &mut self.own[sample.topic];
        let header = MessageHeader {
            channel_id: *id,
            sequence: *sequence,
            log_time: stamp_ns,
            publish_time: self.settings.wall.unix_ns(sample.place.sent_ns),
        };
        *sequence = sequence.wrapping_add(1);
        self.writer.write_to_known_channel(&header, &self.wrapped)?;
        self.unlooked += sample.bytes.len() as u64;
        let told = self.teller.tell(self.topics[sample.topic].name, &sample.bytes, stamp_ns);
        for RosMessage { topic, kind, cdr } in told {
            if !self.ros.contains_key(&topic) {
                self.ros_channel(&topic, kind)?;
            }
            let Some((id, sequence)) = self.ros.get_mut(&topic) else { continue };
            let header = MessageHeader {
                channel_id: *id,
                sequence: *sequence,
                log_time: stamp_ns,
                publish_time: stamp_ns,
            };
            *sequence = sequence.wrapping_add(1);
            self.writer.write_to_known_channel(&header, &cdr)?;
        }
        Ok(())
    }

    fn rotate_if_full(&mut self) -> Result<()> {
        let Some(split_bytes) = self.settings.files.split_bytes else { return Ok(()) };
        if self.unlooked < split_bytes.min(CHUNK_BYTES) {
            return Ok(());
        }
        self.unlooked = 0;
        self.writer.flush()?;
        if self.file.metadata()?.len() < split_bytes {
            return Ok(());
        }
        let mut next = self.settings.files.clone();
        next.number += 1;
        let on = name_of(&next.path());
        self.close(BTreeMap::from([("continued_in".to_owned(), on)]))?;
        self.settings.files = next;
        (self.writer, self.file) = open(&self.settings)?;
        self.begin()
    }

    fn close(&mut self, metadata: BTreeMap<String, String>) -> Result<()> {
        self.writer.write_metadata(&Metadata { name: END.to_owned(), metadata })?;
        self.writer.finish()?;
        Ok(())
    }
}

/// Whether the drives of a request are paced by the clock.
fn is_by_the_clock(mut request: &[u8]) -> bool {
    let _ = BatchHeader::take(&mut request);
    DriveRequest::take(&mut request).is_some_and(|first| has(first.flags, DriveRequest::REAL_TIME))
}

/// Opens the file of the settings, which must be new.
fn open(settings: &Settings) -> Result<(Writer<File>, File)> {
    let path = settings.files.path();
    let failed = || format!("failed to write {}", path.display());
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).with_context(failed)?;
    }
    let file = OpenOptions::new().write(true).create_new(true).open(&path).with_context(failed)?;
    let writer = WriteOptions::new()
        .compression(Some(Compression::Zstd))
        // Compressed in the writing thread: chunks are small.
        .compression_threads(0)
        .compression_level(1)
        .chunk_size(Some(CHUNK_BYTES))
        // So a chunk is written in one go: a file that is cut off ends with a complete chunk.
        .disable_seeking(true)
        .profile("ros2")
        .library(concat!("pathtune ", env!("CARGO_PKG_VERSION")))
        .create(file.try_clone().with_context(failed)?)
        .with_context(failed)?;
    Ok((writer, file))
}
