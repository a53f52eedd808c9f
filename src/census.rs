//! What each module does and has in an app: whose a system is, and whose a component, is found by building an app of that module alone.
//!
//! No promise of a plugin goes into it, and none of its run conditions: a system has run when the engine has noted that it has.

use crate::modules::Module;
use bevy::ecs::change_detection::Tick;
use bevy::ecs::system::ScheduleSystem;
use bevy::prelude::*;
use keyhole_assessment::recording::RecordingPlugin;
use keyhole_whiteboard::WhiteboardPlugin;
use std::any::TypeId;
use std::collections::{BTreeMap, HashMap};

/// Whose systems and whose components there are.
#[derive(Clone, Debug)]
pub struct Census {
    systems: HashMap<TypeId, Module>,
    components: HashMap<TypeId, Module>,
}

/// What one module has in an app.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Holdings {
    /// Entities with a component that this module alone knows.
    pub entities: usize,
    /// Size of these components, bytes, without what they have on the heap.
    pub bytes: usize,
    /// Size of the resources that this module alone knows, bytes, without what they have on the heap: settings and empty lists, in every app.
    pub resource_bytes: usize,
}

/// When each system of a module ran last, in each schedule that it is in.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LastRuns(BTreeMap<(Module, TypeId), Vec<Tick>>);

impl Default for Census {
    fn default() -> Self {
        Self::new()
    }
}

impl Census {
    /// Builds an app of each module alone and looks at what it has brought.
    #[must_use]
    pub fn new() -> Self {
        let shared = types_of(&mut bare());
        let mut found: [HashMap<TypeId, Option<Module>>; 2] = Default::default();
        for module in Module::ALL {
            let mut app = bare();
            module.add(&mut app);
            for ((found, own), shared) in found.iter_mut().zip(types_of(&mut app)).zip(&shared) {
                for id in own.into_iter().filter(|id| !shared.contains(id)) {
                    // What two modules know is neither's.
                    found.entry(id).and_modify(|whose| *whose = whose.filter(|m| *m == module)).or_insert(Some(module));
                }
            }
        }
        let [systems, components] = found.map(|map| map.into_iter().filter_map(|(id, whose)| Some((id, whose?))).collect());
        Self { systems, components }
    }

    /// Number of systems of a module, in all schedules.
    #[must_use]
    pub fn systems(&self, module: Module) -> usize {
        self.systems.values().filter(|m| **m == module).count()
    }

    /// When the systems of every module have run last in an app. Schedules that have not run yet are made ready, so that none is overlooked.
    #[must_use]
    pub fn last_runs(&self, app: &mut App) -> LastRuns {
        let mut runs: BTreeMap<_, Vec<Tick>> = BTreeMap::new();
        each_system(app, |system| {
            if let Some(module) = self.systems.get(&system.system_type()) {
                runs.entry((*module, system.system_type())).or_default().push(system.get_last_run());
            }
        });
        LastRuns(runs)
    }

    /// What each module has in an app.
    #[must_use]
    pub fn holdings(&self, app: &App) -> BTreeMap<Module, Holdings> {
        let mut all: BTreeMap<Module, Holdings> = Module::ALL.map(|m| (m, Holdings::default())).into();
        let world = app.world();
        for archetype in world.archetypes().iter() {
            let mut known = Vec::new();
            for id in archetype.components() {
                let Some(info) = world.components().get_info(*id) else { continue };
                let Some(module) = info.type_id().and_then(|t| self.components.get(&t)) else { continue };
                let of = all.entry(*module).or_default();
                let bytes = info.layout().size() * archetype.len() as usize;
                if world.resource_entities().get(*id).is_some() {
                    of.resource_bytes += bytes;
                } else {
                    of.bytes += bytes;
                    known.push(*module);
                }
            }
            known.sort_unstable();
            known.dedup();
            for module in known {
                all.entry(module).or_default().entities += archetype.len() as usize;
            }
        }
        all
    }
}

impl LastRuns {
    /// How many systems of each module have run since.
    #[must_use]
    pub fn runs_since(&self, before: &Self) -> BTreeMap<Module, u64> {
        let mut runs: BTreeMap<Module, u64> = Module::ALL.map(|m| (m, 0)).into();
        for (key, ticks) in &self.0 {
            let known = before.0.get(key).map_or(&[][..], Vec::as_slice);
            let ran = ticks.iter().enumerate().filter(|(i, tick)| known.get(*i) != Some(tick)).count();
            *runs.entry(key.0).or_default() += ran as u64;
        }
        runs
    }
}

/// What all modules share.
fn bare() -> App {
    let mut app = App::new();
    app.add_plugins((WhiteboardPlugin, RecordingPlugin));
    app
}

/// Looks at every system of an app.
fn each_system(app: &mut App, mut look: impl FnMut(&ScheduleSystem)) {
    let world = app.world_mut();
    let labels: Vec<_> = world.resource::<Schedules>().iter().map(|(_, schedule)| schedule.label()).collect();
    for label in labels {
        world.schedule_scope(label, |world, schedule| {
            // One that cannot be built fails where it is run.
            if schedule.initialize(world).is_ok() {
                schedule.systems().into_iter().flatten().for_each(|(_, system)| look(system));
            }
        });
    }
}

/// The types of the systems of an app, and those of its components and resources.
fn types_of(app: &mut App) -> [Vec<TypeId>; 2] {
    let mut systems = Vec::new();
    each_system(app, |system| systems.push(system.system_type()));
    let components = app.world().components().iter_registered().filter_map(|info| info.type_id()).collect();
    [systems, components]
}
