//! What lets sessions run: threads of their own for real devices, a virtual clock for tests.

use crate::keeper::{Event, Keeper, SCAN};
use crate::profile::Profile;
use crate::session::Session;
use crate::transport::Bus;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::{Builder, JoinHandle};
use std::time::{Duration, Instant};

/// Runs sessions and looks for new devices.
pub enum Service {
    /// A thread that looks for devices, and one for each that is served.
    Threads(Threads),
    /// Everything at the caller's word.
    Stepped(Box<Stepped>),
}

impl Service {
    /// Starts the threads. The bus is made on the thread that looks for devices; should it fail, that is logged and there are no devices.
    #[must_use]
    pub fn threads<E: std::fmt::Display>(bus: impl FnOnce() -> Result<Box<dyn Bus>, E> + Send + 'static, profiles: Vec<Profile>) -> Self {
        let (told, events) = channel();
        let (stop, forget) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
        let flags = (stop.clone(), forget.clone());
        let work = move || match bus() {
            Ok(bus) => keep(Keeper::new(bus, profiles), &told, &flags.0, &flags.1),
            Err(error) => tracing::warn!("no devices: {error}"),
        };
        let looker = Builder::new().name("keyhole-hid".into()).spawn(work);
        if let Err(error) = &looker {
            tracing::warn!("no devices: no thread for them: {error}");
        }
        Self::Threads(Threads { events, stop, forget, looker: looker.ok() })
    }

    /// Nothing happens but by [`Service::advance`].
    #[must_use]
    pub fn stepped(bus: Box<dyn Bus>, profiles: Vec<Profile>) -> Self {
        Self::Stepped(Box::new(Stepped {
            keeper: Keeper::new(bus, profiles),
            sessions: Vec::new(),
            events: Vec::new(),
            scan: Duration::ZERO,
        }))
    }

    /// Lets everything happen until `now` that nobody waits for in threads.
    pub fn advance(&mut self, now: Duration) {
        if let Self::Stepped(stepped) = self {
            stepped.advance(now);
        }
    }

    /// Everything that happened since it was asked last. Never waits.
    pub fn events(&mut self) -> Vec<Event> {
        match self {
            Self::Threads(threads) => threads.events.try_iter().collect(),
            Self::Stepped(stepped) => std::mem::take(&mut stepped.events),
        }
    }

    /// Devices that are gone do not come back to their hands.
    pub fn forget(&mut self) {
        match self {
            Self::Threads(threads) => threads.forget.store(true, Ordering::Release),
            Self::Stepped(stepped) => stepped.keeper.forget(),
        }
    }
}

/// Sessions on a virtual clock.
pub struct Stepped {
    keeper: Keeper,
    sessions: Vec<(u64, Session)>,
    events: Vec<Event>,
    scan: Duration,
}

impl Stepped {
    fn advance(&mut self, now: Duration) {
        loop {
            let until = now.min(self.scan);
            let keeper = &mut self.keeper;
            self.sessions.retain_mut(|(id, session)| {
                while session.now() < until {
                    if session.step(until.saturating_sub(session.now())).is_err() {
                        keeper.closed(*id);
                        return false;
                    }
                }
                true
            });
            if self.scan > now {
                return;
            }
            let (events, sessions) = self.keeper.scan(self.scan);
            self.events.extend(events);
            self.sessions.extend(sessions);
            self.scan += SCAN;
        }
    }
}

/// Threads that end when this is dropped.
pub struct Threads {
    events: Receiver<Event>,
    stop: Arc<AtomicBool>,
    forget: Arc<AtomicBool>,
    looker: Option<JoinHandle<()>>,
}

impl Drop for Threads {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(looker) = self.looker.take() {
            looker.thread().unpark();
            // A thread that panicked has been heard of.
            drop(looker.join());
        }
    }
}

fn keep(mut keeper: Keeper, told: &Sender<Event>, stop: &Arc<AtomicBool>, forget: &AtomicBool) {
    let epoch = Instant::now();
    let (over, ended) = channel();
    let mut threads: Vec<JoinHandle<()>> = Vec::new();
    while !stop.load(Ordering::Acquire) {
        ended.try_iter().for_each(|id| keeper.closed(id));
        if forget.swap(false, Ordering::AcqRel) {
            keeper.forget();
        }
        let (events, sessions) = keeper.scan(epoch.elapsed());
        for (id, session) in sessions {
            let (over, stop) = (over.clone(), stop.clone());
            let serve = move || {
                serve(session, &stop);
                let _ = over.send(id);
            };
            match Builder::new().name(format!("keyhole-hid-{id}")).spawn(serve) {
                Ok(thread) => threads.push(thread),
                Err(error) => {
                    tracing::warn!("a device is not served: no thread for it: {error}");
                    keeper.closed(id);
                }
            }
        }
        for event in events {
            if told.send(event).is_err() {
                stop.store(true, Ordering::Release);
            }
        }
        threads.retain(|t| !t.is_finished());
        if !stop.load(Ordering::Acquire) {
            std::thread::park_timeout(SCAN);
        }
    }
    for thread in threads {
        drop(thread.join());
    }
}

fn serve(mut session: Session, stop: &AtomicBool) {
    while !stop.load(Ordering::Acquire) && session.step(Duration::MAX).is_ok() {}
}
