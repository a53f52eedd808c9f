//! The state of the simulation, kept in memory and put back: what a replay seeks by.
//!
//! Each room says which of its components and resources are state, in one line each while its plugin is built ([`StateOf`]). A [`Checkpoint`] is a clone of all of
//! them at the end of a tick. Put back, the simulation goes on with the same bits: entities keep their ids, and what the simulation has changed in the tick
//! before is as fresh or as old as it was. What is not registered is taken to stay as it is while a scene is played: ports, solid anatomy, settings.
//!
//! Memory: a checkpoint has what its state has; meshes and solvers of large organs are nearly all of it.

use bevy_app::prelude::*;
use bevy_ecs::change_detection::{MAX_CHANGE_AGE, Tick};
use bevy_ecs::component::Mutable;
use bevy_ecs::prelude::*;
use bevy_ecs::system::SystemChangeTick;
use std::any::{Any, TypeId};
use std::sync::Arc;

/// A clone of a component or a resource.
type Value = Arc<dyn Any + Send + Sync>;

/// What the simulation makes of a component that is put back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Arrives {
    /// As something that has just come.
    New,
    /// As something that has long been there: the simulation looks at changes of it within the tick that makes them.
    Old,
    /// As changed if it was changed since contacts were last looked for, else as something that has long been there.
    AsContactsSawIt,
}

/// A type of component that is state.
struct Kind {
    id: TypeId,
    arrives: Arrives,
    /// A clone, and when it was last changed.
    take: fn(EntityRef) -> Option<(Value, Tick)>,
    put: fn(&mut EntityWorldMut, &Value),
    remove: fn(&mut EntityWorldMut),
    /// Sets when it came and was last changed.
    date: fn(&mut EntityWorldMut, Tick),
}

/// A type of resource that is state.
struct Held {
    id: TypeId,
    take: fn(&World) -> Option<Value>,
    put: fn(&mut World, Option<&Value>),
}

/// What is state, and when contacts were last looked for.
#[derive(Resource, Default)]
pub struct StateRegistry {
    kinds: Vec<Kind>,
    held: Vec<Held>,
    other: Vec<TypeId>,
    contacts_seen: Option<Tick>,
}

/// A checkpoint has been put back: who keeps something of the state elsewhere, to draw it, looks at it anew. Triggered by [`Checkpoint::restore`].
#[derive(Event, Clone, Copy, Debug)]
pub struct StateRestored;

/// Says what is state. A type may be named by several rooms.
pub trait StateOf {
    /// The components of this type are state.
    fn state<C: Component<Mutability = Mutable> + Clone>(&mut self) -> &mut Self;

    /// The same of a type whose changes (`Added`, `Changed`) the simulation looks at, in the very tick that makes them.
    fn watched_state<C: Component<Mutability = Mutable> + Clone>(&mut self) -> &mut Self;

    /// The resource of this type is state.
    fn state_resource<R: Resource + Clone>(&mut self) -> &mut Self;

    /// A component or a resource of this type is not: it stays as it is while a scene is played. To be said of what others cannot name.
    fn no_state<T: 'static>(&mut self) -> &mut Self;
}

impl StateOf for App {
    fn state<C: Component<Mutability = Mutable> + Clone>(&mut self) -> &mut Self {
        register::<C>(self, Arrives::New);
        self
    }

    fn watched_state<C: Component<Mutability = Mutable> + Clone>(&mut self) -> &mut Self {
        register::<C>(self, Arrives::Old);
        self
    }

    fn state_resource<R: Resource + Clone>(&mut self) -> &mut Self {
        let registry = &mut *self.world_mut().get_resource_or_init::<StateRegistry>();
        let put = |world: &mut World, value: Option<&Value>| match value.and_then(|v| v.downcast_ref::<R>()) {
            Some(value) => world.insert_resource(value.clone()),
            None => {
                world.remove_resource::<R>();
            }
        };
        if registry.held.iter().all(|held| held.id != TypeId::of::<R>()) {
            let take = |world: &World| world.get_resource::<R>().map(|r| Arc::new(r.clone()) as Value);
            registry.held.push(Held { id: TypeId::of::<R>(), take, put });
        }
        self
    }

    fn no_state<T: 'static>(&mut self) -> &mut Self {
        self.world_mut().get_resource_or_init::<StateRegistry>().other.push(TypeId::of::<T>());
        self
    }
}

fn register<C: Component<Mutability = Mutable> + Clone>(app: &mut App, arrives: Arrives) {
    let registry = &mut *app.world_mut().get_resource_or_init::<StateRegistry>();
    if registry.kinds.iter().any(|kind| kind.id == TypeId::of::<C>()) {
        return;
    }
    registry.kinds.push(Kind {
        id: TypeId::of::<C>(),
        arrives,
        take: |entity| entity.get_ref::<C>().map(|value| (Arc::new(C::clone(&value)) as Value, value.last_changed())),
        put: |entity, value| {
            if let Some(value) = value.downcast_ref::<C>() {
                entity.insert(value.clone());
            }
        },
        remove: |entity| {
            entity.remove::<C>();
        },
        date: |entity, tick| {
            if let Some(mut value) = entity.get_mut::<C>() {
                value.set_last_added(tick);
                value.set_last_changed(tick);
            }
        },
    });
}

impl StateRegistry {
    /// Whether somebody has said of a type of component or resource whether it is state.
    #[must_use]
    pub fn knows(&self, id: TypeId) -> bool {
        self.kinds.iter().any(|kind| kind.id == id) || self.held.iter().any(|held| held.id == id) || self.other.contains(&id)
    }

    /// The entities that have something of the state, ascending.
    fn entities(&self, world: &World) -> Vec<Entity> {
        let ids: Vec<_> = self.kinds.iter().filter_map(|kind| world.components().get_id(kind.id)).collect();
        let with_state = world.archetypes().iter().filter(|archetype| ids.iter().any(|id| archetype.contains(*id)));
        let mut entities: Vec<Entity> = with_state.flat_map(|archetype| archetype.entities().iter().map(|e| e.id())).collect();
        entities.sort_unstable();
        entities
    }
}

/// The state at the end of a tick.
#[derive(Clone)]
pub struct Checkpoint {
    /// Of each entity, ascending: its components in the order of the registry, and whether each had been changed since contacts were looked for.
    entities: Vec<(Entity, Vec<Option<(Value, bool)>>)>,
    resources: Vec<Option<Value>>,
}

impl Checkpoint {
    /// Clones the state. To be called between ticks, after one that has run.
    #[must_use]
    pub fn take(world: &World) -> Self {
        let Some(registry) = world.get_resource::<StateRegistry>() else { return Self { entities: Vec::new(), resources: Vec::new() } };
        let now = world.read_change_tick();
        let fresh = |changed: Tick| registry.contacts_seen.is_none_or(|seen| changed.is_newer_than(seen, now));
        let of = |entity: Entity| {
            let entity = world.entity(entity);
            registry.kinds.iter().map(|kind| (kind.take)(entity).map(|(value, changed)| (value, fresh(changed)))).collect()
        };
        let entities = registry.entities(world).into_iter().map(|entity| (entity, of(entity))).collect();
        Self { entities, resources: registry.held.iter().map(|held| (held.take)(world)).collect() }
    }

    /// Puts the state back. Entities that it does not know lose all that they have and stay empty, so that a later checkpoint finds them.
    ///
    /// To be called between ticks of the world that it is of, while nothing that it knows has been despawned.
    pub fn restore(&self, world: &mut World) {
        let Some(registry) = world.remove_resource::<StateRegistry>() else { return };
        for entity in registry.entities(world) {
            let Ok(mut entity) = world.get_entity_mut(entity) else { continue };
            if self.entities.binary_search_by_key(&entity.id(), |(known, _)| *known).is_err() {
                entity.clear();
                continue;
            }
            registry.kinds.iter().for_each(|kind| (kind.remove)(&mut entity));
        }
        world.flush();
        // Newer than the last run of every system, and older than the next.
        world.increment_change_tick();
        self.each(&registry, world, |entity, kind, value| {
            if let Some((value, _)) = value {
                (kind.put)(entity, value);
            }
        });
        world.flush();
        let long_ago = Tick::new(world.change_tick().get().wrapping_sub(MAX_CHANGE_AGE / 2));
        self.each(&registry, world, |entity, kind, value| match (value, kind.arrives) {
            // What came along with something else.
            (None, _) => (kind.remove)(entity),
            (Some(_), Arrives::Old) | (Some((_, false)), Arrives::AsContactsSawIt) => (kind.date)(entity, long_ago),
            (Some(_), Arrives::New | Arrives::AsContactsSawIt) => {}
        });
        for (held, value) in registry.held.iter().zip(&self.resources) {
            (held.put)(world, value.as_ref());
        }
        world.increment_change_tick();
        world.insert_resource(registry);
        world.trigger(StateRestored);
        world.flush();
    }

    fn each(&self, registry: &StateRegistry, world: &mut World, mut with: impl FnMut(&mut EntityWorldMut, &Kind, Option<&(Value, bool)>)) {
        for (entity, values) in &self.entities {
            let Ok(mut entity) = world.get_entity_mut(*entity) else { continue };
            registry.kinds.iter().zip(values).for_each(|(kind, value)| with(&mut entity, kind, value.as_ref()));
        }
    }
}

/// Everything on the whiteboard that a tick changes.
pub(crate) fn register_whiteboard(app: &mut App) {
    use crate::*;
    app.state::<Organ>().state::<OrganMaterials>().state::<TissueMesh>().state::<FreedFrom>().state::<Attachments>().state::<Contacts>();
    register::<TissueState>(app, Arrives::AsContactsSawIt);
    app.watched_state::<ToolModel>().watched_state::<RigidPose>();
    app.state::<Instrument>().state::<InstrumentPose>().state::<Jaws>().state::<CuttingLine>().state::<Blade>().state::<Endoscope>();
    app.state::<Tray>().state::<Exchange>().state::<ToolForce>().state::<ToolContacts>().state::<Suction>().state::<SuctionValve>();
    app.state::<JawPads>().state::<Grasp>().state::<Bruises>().state::<ClipShape>().state::<ClipApplier>().state::<Clip>();
    app.state::<RigidBody>().state::<RigidMass>().state::<HeldBy>().state::<Rigidified>().state::<RigidQuarantined>();
    app.state::<Needle>().state::<Thread>().state::<Bites>().state::<Knots>();
    app.state_resource::<CutStatus>().state_resource::<ScriptClock>().state_resource::<TickCost>();
    app.state_resource::<RigidReport>().state_resource::<BleedReport>().state_resource::<ClipReport>();
    let note = |mut registry: ResMut<StateRegistry>, ticks: SystemChangeTick| registry.contacts_seen = Some(ticks.this_run());
    app.add_systems(FixedUpdate, note.after(TickSystems::Collide).before(TickSystems::Tissue).run_if(crate::tick::running));
}
