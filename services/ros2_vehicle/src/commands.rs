//! The writer of the commands, which knows whether they arrive.

use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Waker};

use rustdds::no_key::DataWriterCdr;
use rustdds::{DataWriterStatus, StatusEvented, Timestamp};
use serde::Serialize;

use crate::hearing::Answer;

/// Ready once all reliable readers have everything up to the command that was sent last when it was made.
type Awaited = Pin<Box<dyn Future<Output = ()> + Send>>;

/// Sends commands. Sending one succeeds whether or not anybody hears it: the writer keeps thousands for readers that do
/// not answer.
pub(crate) struct Commands<M: Serialize> {
    writer: Arc<DataWriterCdr<M>>,
    awaited: Option<Awaited>,
    /// An answer came that nobody has been told of.
    is_answered: bool,
    /// How many readers there are.
    readers: i32,
}

impl<M: Serialize + Send + Sync + 'static> Commands<M> {
    pub(crate) fn new(writer: DataWriterCdr<M>) -> Self {
        Self { writer: Arc::new(writer), awaited: None, is_answered: false, readers: 0 }
    }

    /// Sends a command.
    pub(crate) fn send(&mut self, command: M) -> Result<(), String> {
        self.writer.write(command, Some(Timestamp::now())).map_err(|why| why.to_string())?;
        self.count_readers();
        // Without readers it would be ready at once.
        if self.awaited.is_none() && self.readers > 0 {
            let writer = Arc::clone(&self.writer);
            self.awaited = Some(Box::pin(async move {
                // It can fail no more than sending does.
                let _ = writer.async_wait_for_acknowledgments().await;
            }));
            // Which command it is about is settled when it is first looked at.
            self.look();
        }
        Ok(())
    }

    /// What is known of the commands that were sent. Readers that ask for no reliability say nothing: they count as if
    /// they had answered.
    pub(crate) fn answer(&mut self) -> Answer {
        self.count_readers();
        self.look();
        match (std::mem::take(&mut self.is_answered), &self.awaited) {
            (true, _) => Answer::Given,
            (false, Some(_)) => Answer::Awaited,
            (false, None) => Answer::NotAsked,
        }
    }

    fn look(&mut self) {
        let mut context = Context::from_waker(Waker::noop());
        if let Some(awaited) = &mut self.awaited
            && awaited.as_mut().poll(&mut context).is_ready()
        {
            self.awaited = None;
            self.is_answered = true;
        }
    }

    fn count_readers(&mut self) {
        while let Some(status) = self.writer.try_recv_status() {
            if let DataWriterStatus::PublicationMatched { current, .. } = status {
                self.readers = current.count();
            }
        }
    }
}
