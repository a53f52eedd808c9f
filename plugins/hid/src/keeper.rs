//! Which devices are served: what is plugged in, which profile it gets, whose hand it is, and what it was before it was unplugged.

use crate::error::TransportError;
use crate::profile::{HandChoice, Match, Profile};
use crate::session::{Line, Session, SessionError};
use crate::transport::{Bus, DeviceInfo};
use keyhole_whiteboard::{DeviceCondition, Hand};
use std::sync::Arc;
use std::time::Duration;

/// Time between two looks at what is plugged in.
pub const SCAN: Duration = Duration::from_millis(500);

/// What a look found that was not known.
pub enum Event {
    /// A device is served now. One that was unplugged comes back with its number and its hands.
    Opened {
        /// Number of the device.
        id: u64,
        /// The device.
        info: DeviceInfo,
        /// Its profile.
        profile: Arc<Profile>,
        /// The hands of the profile, in its order.
        hands: Vec<Hand>,
        /// Where it is heard.
        line: Line,
    },
    /// A device with a profile cannot be served.
    Refused {
        /// The device.
        info: DeviceInfo,
        /// Its profile.
        profile: Arc<Profile>,
        /// How it is.
        condition: DeviceCondition,
        /// What to do.
        advice: String,
    },
    /// A device that was refused is gone, or will be served.
    Withdrawn {
        /// Where it was.
        path: String,
    },
}

struct Served {
    id: u64,
    info: DeviceInfo,
    profile: Arc<Profile>,
    hands: Vec<Hand>,
    open: bool,
}

/// Keeps the books of a bus.
pub struct Keeper {
    bus: Box<dyn Bus>,
    profiles: Vec<Arc<Profile>>,
    served: Vec<Served>,
    refused: Vec<(String, String)>,
    next: u64,
}

impl Keeper {
    /// A bus on which nothing has been looked at. Of profiles that match equally well the first is taken.
    #[must_use]
    pub fn new(bus: Box<dyn Bus>, profiles: Vec<Profile>) -> Self {
        Self { bus, profiles: profiles.into_iter().map(Arc::new).collect(), served: Vec::new(), refused: Vec::new(), next: 0 }
    }

    /// Looks at what is plugged in: what happened, and the sessions of what is served from now on.
    pub fn scan(&mut self, now: Duration) -> (Vec<Event>, Vec<(u64, Session)>) {
        let (mut events, mut sessions) = (Vec::new(), Vec::new());
        // A bus that does not tell now will tell the next time; nothing is lost that is open.
        let Ok(devices) = self.bus.list(now) else { return (events, sessions) };
        self.refused.retain(|(path, _)| {
            let there = devices.iter().any(|d| d.path == *path);
            if !there {
                events.push(Event::Withdrawn { path: path.clone() });
            }
            there
        });
        let mut found: Vec<(u8, DeviceInfo, Arc<Profile>)> = Vec::new();
        for info in devices {
            if self.served.iter().any(|s| s.open && s.info.path == info.path) {
                continue;
            }
            if let Some((rank, profile)) = self.profile_of(&info) {
                found.push((rank, info, profile));
            }
        }
        // Who is meant by name comes before who is one of a kind.
        found.sort_by_key(|(rank, ..)| *rank);
        for (rank, info, profile) in found {
            match self.serve(&info, &profile, now) {
                Ok((id, hands, session, line)) => {
                    if let Some(at) = self.refused.iter().position(|(path, _)| *path == info.path) {
                        self.refused.remove(at);
                        events.push(Event::Withdrawn { path: info.path.clone() });
                    }
                    events.push(Event::Opened { id, info, profile, hands, line });
                    sessions.push((id, session));
                }
                // A joystick that is not like a gamepad is not for this program: nobody meant it.
                Err((DeviceCondition::Unsuitable, _)) if rank == BY_KIND => {}
                Err((condition, advice)) => {
                    let known = (info.path.clone(), advice.clone());
                    if !self.refused.contains(&known) {
                        self.refused.retain(|(path, _)| *path != info.path);
                        self.refused.push(known);
                        events.push(Event::Refused { info, profile, condition, advice });
                    }
                }
            }
        }
        (events, sessions)
    }

    /// The session of a device is over.
    pub fn closed(&mut self, id: u64) {
        if let Some(served) = self.served.iter_mut().find(|s| s.id == id) {
            served.open = false;
        }
    }

    /// Devices that are gone do not come back to their hands.
    pub fn forget(&mut self) {
        self.served.retain(|s| s.open);
    }

    fn profile_of(&self, info: &DeviceInfo) -> Option<(u8, Arc<Profile>)> {
        let ranked = self.profiles.iter().filter_map(|p| Some((rank(p, info)?, p)));
        ranked.min_by_key(|(rank, _)| *rank).map(|(rank, p)| (rank, p.clone()))
    }

    fn serve(
        &mut self,
        info: &DeviceInfo,
        profile: &Arc<Profile>,
        now: Duration,
    ) -> Result<(u64, Vec<Hand>, Session, Line), (DeviceCondition, String)> {
        let before = self.served.iter().position(|s| !s.open && s.info.is_same(info) && s.profile == *profile);
        let hands = match before {
            Some(at) => self.served[at].hands.clone(),
            None => self.free_hands(profile).ok_or_else(|| {
                let advice = "the hand that it is for is in another device: unplug that one, and start the scene over".to_owned();
                (DeviceCondition::Unsuitable, advice)
            })?,
        };
        let opened = self.bus.open(info, now).map_err(SessionError::from).and_then(|t| Session::new(t, profile));
        let (session, line) = opened.map_err(|error| match error {
            SessionError::Transport(TransportError::Denied { rule, .. }) => (DeviceCondition::Denied, rule),
            SessionError::Transport(TransportError::Gone(_)) => (DeviceCondition::Unplugged, "plug it in again".into()),
            SessionError::Transport(TransportError::Fault(e)) => {
                (DeviceCondition::Silent, format!("{e}: unplug it and plug it in again; another program may hold it"))
            }
            SessionError::Fit(e) => (DeviceCondition::Unsuitable, format!("{e}. `keyhole device calibrate` writes a profile for it")),
        })?;
        let id = match before {
            Some(at) => {
                self.served[at].open = true;
                self.served[at].info = info.clone();
                self.served[at].id
            }
            None => {
                self.next += 1;
                let served = Served { id: self.next, info: info.clone(), profile: profile.clone(), hands: hands.clone(), open: true };
                self.served.push(served);
                self.next
            }
        };
        Ok((id, hands, session, line))
    }

    fn free_hands(&self, profile: &Profile) -> Option<Vec<Hand>> {
        let free = |hand: Hand| !self.served.iter().any(|s| s.hands.contains(&hand));
        let choose = |choice| match choice {
            HandChoice::Left => Some(Hand::Left).filter(|h| free(*h)),
            HandChoice::Right => Some(Hand::Right).filter(|h| free(*h)),
            HandChoice::Any => [Hand::Right, Hand::Left].into_iter().find(|h| free(*h)),
        };
        profile.hands.iter().map(|h| choose(h.hand)).collect()
    }
}

/// Rank of a profile that matches by the kind of the device alone.
const BY_KIND: u8 = 3;

/// How well a profile matches, the smaller the better; `None` when it does not.
#[must_use]
pub fn rank(profile: &Profile, info: &DeviceInfo) -> Option<u8> {
    let rank = |m: &Match| match m {
        Match::Device { vendor, product: Some(product) } if (*vendor, *product) == (info.vendor, info.product) => Some(0),
        Match::Device { vendor, product: None } if *vendor == info.vendor => Some(2),
        Match::Named(part) if info.name.to_lowercase().contains(&part.to_lowercase()) => Some(1),
        Match::Usage { page, usage } if info.usages.contains(&(*page, *usage)) => Some(BY_KIND),
        _ => None,
    };
    profile.matches.iter().filter_map(rank).min()
}
