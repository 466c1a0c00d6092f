//! A flag that a signal sets and long loops look at.

use crate::{Error, Result};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::Duration;

/// Shared flag; clones see the same one.
#[derive(Clone, Debug, Default)]
pub struct Cancel(Arc<AtomicBool>);

impl Cancel {
    /// Asks everything that holds a clone to stop. Returns whether that was asked before.
    pub fn request(&self) -> bool {
        self.0.swap(true, Ordering::Relaxed)
    }

    /// What long work comes to that does not look at the flag itself: it runs in a thread of its
    /// own, which is left behind with it after a stop.
    ///
    /// # Errors
    /// [`Error::cancelled`]; no thread, or a panic of the work.
    pub(crate) fn while_busy<T: Send + 'static>(
        &self,
        name: &str,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T> {
        const PATIENCE: Duration = Duration::from_millis(50);
        let (done, result) = mpsc::channel();
        let work = move || {
            // Nobody is left to have it after a stop.
            let _ = done.send(work());
        };
        thread::Builder::new()
            .name(name.into())
            .spawn(work)
            .map_err(|e| Error::failed(format!("cannot start a thread: {e}")))?;
        loop {
            match result.recv_timeout(PATIENCE) {
                Ok(value) => return Ok(value),
                Err(RecvTimeoutError::Timeout) => self.check()?,
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(Error::failed(format!("the thread {name} was not finished")));
                }
            }
        }
    }

    /// An error once a stop was requested.
    ///
    /// # Errors
    /// [`Error::cancelled`].
    pub fn check(&self) -> Result<()> {
        if self.0.load(Ordering::Relaxed) {
            Err(Error::cancelled())
        } else {
            Ok(())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_does_not_wait_for_work_that_is_deaf() {
        let cancel = Cancel::default();
        assert_eq!(cancel.while_busy("adder", || 2 + 2).unwrap(), 4);
        cancel.request();
        let (end, ended) = mpsc::channel::<()>();
        let forever = move || ended.recv().is_ok();
        let error = cancel.while_busy("sleeper", forever).unwrap_err();
        assert_eq!(error.kind(), crate::Kind::Cancelled);
        drop(end);
    }

    #[test]
    fn clones_share_the_flag() {
        let cancel = Cancel::default();
        let clone = cancel.clone();
        clone.check().unwrap();
        assert!(!cancel.request());
        assert!(cancel.request());
        assert_eq!(clone.check().unwrap_err().kind(), crate::Kind::Cancelled);
    }
}
