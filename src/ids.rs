//! Ids of what the simulation spawns: each is greater than all before it, whatever a window has spawned and despawned meanwhile.
//!
//! What is simulated is put into order by id. An id that is used again comes out of order; so while a tick runs, and while a scene is put up, ids that were
//! given back are set aside.

use bevy::ecs::entity::EntityGeneration;
use bevy::prelude::*;

/// Ids that were given back and wait to be used again.
#[derive(Resource, Debug, Default)]
pub struct SpareIds(Vec<Entity>);

/// Sets the ids that were given back aside: what is spawned from now on gets new ones.
pub fn set_aside(world: &mut World) {
    world.init_resource::<SpareIds>();
    world.resource_scope(|world, mut spare: Mut<SpareIds>| {
        loop {
            let id = world.entity_allocator().alloc();
            if id.generation() == EntityGeneration::FIRST {
                // None is left: this one is the next.
                world.entity_allocator_mut().free(id);
                break;
            }
            spare.0.push(id);
        }
    });
}

/// Gives them back: what is spawned from now on, to be drawn, uses them again.
pub fn give_back(world: &mut World) {
    let ids = std::mem::take(&mut world.get_resource_or_init::<SpareIds>().0);
    world.entity_allocator_mut().free_many(&ids);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Views come and go between ticks; what ticks spawn is in order, and no id is lost.
    #[test]
    fn what_ticks_spawn_is_in_order() {
        let mut world = World::new();
        let mut views = Vec::new();
        let mut simulated: Vec<Entity> = Vec::new();
        let mut largest = 0;
        for tick in 0..200_usize {
            set_aside(&mut world);
            simulated.extend((0..tick % 3).map(|_| world.spawn_empty().id()));
            give_back(&mut world);
            views.extend((0..4).map(|_| world.spawn_empty().id()));
            let gone = views.len() / 2;
            assert!(views.drain(..gone).all(|view| world.despawn(view)));
            largest = views.iter().map(|v| v.index_u32()).fold(largest, u32::max);
        }
        assert!(simulated.is_sorted() || simulated.iter().rev().is_sorted());
        assert!(simulated.iter().all(|id| id.generation() == EntityGeneration::FIRST));
        // Eight views at the most are there at once: but for the ids of the simulated, theirs are used again and again.
        assert!(largest as usize <= simulated.len() + 16, "{largest} with {}", simulated.len());
    }
}
