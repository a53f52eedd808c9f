//! Ids of what the simulation spawns, in the order in which it is spawned.
//!
//! What is simulated is put into order by id, so that the order does not depend on how it is stored. The engine gives ids again that were given back, and a
//! view gives back many: with those, the order of two clips would depend on what was drawn before. So ids that were never used are set aside for the
//! simulation. Who spawns with [`bevy_ecs::system::Commands::spawn`] instead gets an id out of order, and has to order what it spawns by something else.

use bevy_ecs::entity::EntityGeneration;
use bevy_ecs::prelude::*;
use std::collections::VecDeque;

/// Ids that are set aside at a time: more than a tick spawns.
const AT_A_TIME: u32 = 512;

/// Ids that have never been used, ascending.
#[derive(Resource, Debug, Default)]
pub struct SimulationIds {
    aside: VecDeque<Entity>,
    /// The last that was set aside.
    last: Option<u32>,
}

impl SimulationIds {
    /// Spawns something when the commands are applied; greater than all that was spawned so before. (In a tick that spawns more than are set aside, the rest
    /// comes out of order.)
    pub fn spawn(&mut self, commands: &mut Commands, bundle: impl Bundle) -> Entity {
        let Some(entity) = self.aside.pop_front() else { return commands.spawn(bundle).id() };
        commands.queue(move |world: &mut World| -> Result {
            world.spawn_at(entity, bundle)?;
            Ok(())
        });
        entity
    }

    /// Spawns something at once, in the same order.
    pub fn spawn_in(world: &mut World, bundle: impl Bundle) -> EntityWorldMut<'_> {
        Self::set_aside(world);
        let next = world.resource_mut::<Self>().aside.pop_front();
        match next.filter(|id| world.entities().check_can_spawn_at(*id).is_ok()) {
            // Nobody else has the id.
            Some(id) if world.spawn_at(id, ()).is_ok() => {
                let mut entity = world.entity_mut(id);
                entity.insert(bundle);
                entity
            }
            _ => world.spawn(bundle),
        }
    }

    /// Sets ids aside where few are left. Done before each tick.
    pub fn set_aside(world: &mut World) {
        world.init_resource::<Self>();
        world.resource_scope(|world, mut ids: Mut<Self>| {
            let mut used = Vec::new();
            while ids.aside.len() < AT_A_TIME as usize {
                for id in world.entity_allocator().alloc_many(AT_A_TIME) {
                    if id.generation() == EntityGeneration::FIRST && ids.last.is_none_or(|last| id.index_u32() > last) {
                        ids.last = Some(id.index_u32());
                        ids.aside.push_back(id);
                    } else {
                        used.push(id);
                    }
                }
            }
            world.entity_allocator_mut().free_many(&used);
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Views come and go between ticks; what ticks spawn is in order, at once or by commands, and no more ids are used than there have to be.
    #[test]
    fn what_ticks_spawn_is_in_order() {
        let mut world = World::new();
        let mut views = Vec::new();
        let mut simulated: Vec<Entity> = Vec::new();
        let mut largest = 0;
        for tick in 0..2000_usize {
            SimulationIds::set_aside(&mut world);
            if tick % 3 == 0 {
                world.resource_scope(|world, mut ids: Mut<SimulationIds>| simulated.push(ids.spawn(&mut world.commands(), Name::new("a"))));
                world.flush();
                simulated.push(SimulationIds::spawn_in(&mut world, Name::new("b")).id());
            }
            views.extend((0..40).map(|_| world.spawn_empty().id()));
            let gone = views.len() / 2;
            assert!(views.drain(..gone).all(|view| world.despawn(view)));
            largest = views.iter().map(|v| v.index_u32()).fold(largest, u32::max);
        }
        assert!(simulated.is_sorted() || simulated.iter().rev().is_sorted());
        assert!(simulated.iter().all(|id| world.get::<Name>(*id).is_some()));
        assert!((largest as usize) < simulated.len() + 4 * AT_A_TIME as usize, "{largest} with {}", simulated.len());
    }
}
