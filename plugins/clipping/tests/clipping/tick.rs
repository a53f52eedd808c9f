//! The plugin in an app, tick by tick.

use crate::meshes::block;
use bevy_app::App;
use bevy_ecs::prelude::*;
use bevy_ecs::schedule::ScheduleLabel;
use bevy_math::{Isometry3d, Vec3};
use bevy_time::{Fixed, Time, TimePlugin, TimeUpdateStrategy};
use keyhole_clipping::ClippingPlugin;
use keyhole_clipping::bleed::flow_ml_min;
use keyhole_tetmesh::{DVec3, NodeId, Tet, TetMesh};
use keyhole_whiteboard::{
    Attachments, BleedReport, Clip, ClipApplier, ClipReport, ClipShape, HeldBy, InstrumentPose, JawPads, Jaws, Organ, RigidBody, RigidPose,
    SceneRequirements, StaticSurface, Suction, SuctionValve, TickSystems, TissueMesh, TissueState, TopologyChanged, Vessel, VesselEnd,
    WhiteboardPlugin,
};

const ARTERY: VesselEnd = VesselEnd { pressure_pa: 13_332.0, supply_ml_min: 600.0 };

fn app() -> App {
    let mut app = App::new();
    app.add_plugins((TimePlugin, WhiteboardPlugin, ClippingPlugin));
    app.insert_resource(TimeUpdateStrategy::FixedTimesteps(1));
    app.insert_resource(Time::<Fixed>::from_hz(60.0));
    app.insert_resource(SceneRequirements { clipping: true, ..Default::default() });
    app.init_resource::<Blade>().add_systems(bevy_app::FixedUpdate, cut.in_set(TickSystems::Cut));
    // The first update only starts the clocks.
    app.update();
    app
}

/// What is to be cut in the next tick, where cutting cuts.
#[derive(Resource, Default)]
struct Blade(Option<Box<dyn FnOnce(&mut World) + Send + Sync>>);

fn cut(world: &mut World) {
    if let Some(cut) = world.resource_mut::<Blade>().0.take() {
        cut(world);
    }
}

/// A bar of 40 x 8 x 8 mm along X with an artery of 5 mm along its middle.
fn bar(app: &mut App, far: VesselEnd) -> Entity {
    let mesh = block([20, 4, 4], [0.04, 0.008, 0.008]);
    let state = TissueState::at_rest(&mesh);
    let line = vec![Vec3::new(0.001, 0.004, 0.004), Vec3::new(0.039, 0.004, 0.004)];
    let vessel = Vessel { name: "artery".into(), line, radius_m: 0.0025, wall_m: 0.0, near: ARTERY, far };
    app.world_mut().spawn((Organ { name: "bar".into() }, TissueMesh(mesh), state, vessel)).id()
}

fn still(at: Isometry3d) -> InstrumentPose {
    InstrumentPose { now: at, before: at }
}

fn applier(app: &mut App) -> Entity {
    app.world_mut().spawn((ClipApplier::default(), InstrumentPose::default(), Jaws { angle_rad: 0.6 })).id()
}

/// Opens the jaws with the crown at a place, the legs across the bar towards -Z, and closes them.
fn fire(app: &mut App, tool: Entity, x: f32, crown_z: f32) {
    let crown = app.world().get::<ClipApplier>(tool).unwrap().crown_m;
    *app.world_mut().get_mut::<InstrumentPose>(tool).unwrap() = still(Isometry3d::from_xyz(x, 0.004, crown_z + crown));
    for angle_rad in [0.6, 0.3, 0.0] {
        app.world_mut().get_mut::<Jaws>(tool).unwrap().angle_rad = angle_rad;
        app.update();
    }
}

fn clips(app: &mut App) -> Vec<(Entity, Clip)> {
    let mut query = app.world_mut().query::<(Entity, &Clip)>();
    query.iter(app.world()).map(|(e, c)| (e, c.clone())).collect()
}

/// Cuts the bar through by taking a slice out of it.
fn sever(app: &mut App, organ: Entity, from_x: f64) {
    let cut = move |world: &mut World| {
        let mut mesh = world.get_mut::<TissueMesh>(organ).unwrap();
        let middle = |t| mesh.0.points(t).into_iter().sum::<DVec3>().x / 4.0;
        let gone: Vec<_> = mesh.0.iter().map(|(t, _)| t).filter(|t| (from_x..from_x + 0.002).contains(&middle(*t))).collect();
        gone.into_iter().for_each(|t| mesh.0.remove_tet(t));
        let delta = mesh.0.take_delta();
        world.write_message(TopologyChanged { organ, delta });
    };
    app.insert_resource(Blade(Some(Box::new(cut))));
}

/// Splits every tetrahedron that has one of these points in four around its middle.
fn split(world: &mut World, organ: Entity, points: &[keyhole_whiteboard::TissuePoint]) {
    let mut mesh = world.get_mut::<TissueMesh>(organ).unwrap();
    let has_one = |c: &[NodeId; 4]| points.iter().any(|p| p.iter().all(|(n, _)| c.contains(n)));
    let cut: Vec<_> = mesh.0.iter().filter(|(_, c)| has_one(c)).collect();
    for (tet, c) in &cut {
        let at = c.iter().map(|n| mesh.0.rest(*n)).sum::<DVec3>() / 4.0;
        let middle = mesh.0.add_node(at, c.iter().map(|n| (*n, 0.25)).collect());
        mesh.0.remove_tet(*tet);
        for i in 0..4 {
            let mut child = *c;
            child[i] = middle;
            mesh.0.add_tet(child, Tet::default());
        }
    }
    let delta = mesh.0.take_delta();
    let mut state = world.get_mut::<TissueState>(organ).unwrap();
    for (_, c) in cut {
        let middle = c.iter().map(|n| state.positions[n.index()]).sum::<Vec3>() / 4.0;
        state.positions.push(middle);
        state.velocities.push(Vec3::ZERO);
    }
    world.write_message(TopologyChanged { organ, delta });
}

fn rate(app: &App) -> f32 {
    app.world().resource::<BleedReport>().rate_ml_min
}

#[test]
fn a_cut_without_clips_bleeds_and_between_two_it_does_not() {
    let mut app = app();
    let organ = bar(&mut app, ARTERY);
    let tool = applier(&mut app);
    app.update();
    assert_eq!(rate(&app), 0.0);
    sever(&mut app, organ, 0.02);
    app.update();
    app.update();
    // By hand: a lumen of 19.63 mm2 lets a contracted jet of 60.2 ml/s out at 13.3 kPa; behind the resistance of 1333 Pa/(ml/s) it is 9.87 ml/s = 592 ml/min
    // from each end.
    let whole = rate(&app);
    println!("{whole} ml/min from both ends");
    assert!((whole - 2.0 * 585.0).abs() < 20.0, "{whole}");
    let by_law = 2.0 * flow_ml_min(&ARTERY, std::f64::consts::PI * 0.0025f64.powi(2));
    assert!((f64::from(whole) / by_law - 1.0).abs() < 1e-4);
    let report = app.world().resource::<BleedReport>().clone();
    assert_eq!(report.sites.len(), 2);
    assert!(report.sites.iter().all(|s| s.organ == organ && s.at.distance(Vec3::new(0.021, 0.004, 0.004)) < 0.0025), "{report:?}");
    for _ in 0..60 {
        app.update();
    }
    let lost = app.world().resource::<BleedReport>().lost_ml - report.lost_ml;
    assert!((lost - f64::from(whole) / 60.0).abs() < 1e-3, "{lost} ml in a second");
    fire(&mut app, tool, 0.012, 0.0085);
    app.update();
    assert!((rate(&app) / whole - 0.5).abs() < 1e-4, "a clip on one side closes that side");
    fire(&mut app, tool, 0.03, 0.0085);
    app.update();
    assert_eq!((rate(&app), app.world().resource::<BleedReport>().sites.len()), (0.0, 0));
    assert_eq!(*app.world().resource::<ClipReport>(), ClipReport { set: 2, ..Default::default() });
    assert_eq!(app.world().get::<ClipApplier>(tool).unwrap().clips, 18);
}

/// What was lost lies in pools, was aspirated, or is gone, tick by tick; an open suction takes up what it lets through and no more, none while it is shut or away from the blood,
/// and loss goes on as before.
#[test]
fn what_bleeds_lies_until_it_is_aspirated() {
    let mut app = app();
    let organ = bar(&mut app, ARTERY);
    let corners = [[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]].map(|[x, z]| Vec3::new(x, -0.01, z)).to_vec();
    let bed = app.world_mut().spawn(StaticSurface { vertices: corners, triangles: vec![[0, 1, 2], [0, 2, 3]] }).id();
    let suction = Suction { most_ml_s: 30.0, ..Suction::default() };
    let tool = app.world_mut().spawn((suction, InstrumentPose::default())).id();
    app.update();
    sever(&mut app, organ, 0.02);
    let tick = |app: &mut App| {
        let before = app.world().resource::<BleedReport>().clone();
        app.update();
        let now = app.world().resource::<BleedReport>().clone();
        let known = now.pooled_ml() + now.aspirated_ml + now.gone_ml;
        assert!((now.lost_ml - known).abs() <= 1e-6 * now.lost_ml, "{} ml were lost, {known} ml are known of", now.lost_ml);
        assert!(now.aspirated_ml - before.aspirated_ml <= 1.000_001 * 30.0 / 60.0);
        now
    };
    let lying = (0..60).map(|_| tick(&mut app)).last().unwrap();
    assert_eq!((lying.aspirated_ml, lying.gone_ml), (0.0, 0.0));
    assert!(
        lying.pooled_ml() > 15.0 && lying.pools.iter().all(|p| (p.at.y + 0.01).abs() < 1e-6 && p.normal == Vec3::Y),
        "{:?}",
        lying.pools
    );
    // Open, but its mouth is high above; then in the blood, but shut.
    let mouth_at = |place: Vec3| still(Isometry3d::from_translation(place + suction.mouth_m * Vec3::Z));
    let pool = lying.pools[0].at;
    for (place, open) in [(pool + 0.02 * Vec3::Y, true), (pool + 0.001 * Vec3::Y, false)] {
        app.world_mut().entity_mut(tool).insert((mouth_at(place), SuctionValve { open }));
        assert_eq!((0..10).map(|_| tick(&mut app)).last().unwrap().aspirated_ml, 0.0);
    }
    // Two ends bleed some 19.5 ml/s together, each into a pool or both into one: half a second of 30 ml/s.
    app.world_mut().entity_mut(tool).insert(SuctionValve { open: true });
    let taken = (0..30).map(|_| tick(&mut app)).last().unwrap();
    println!("{:?}, {} ml aspirated of {} ml", taken.pools, taken.aspirated_ml, taken.lost_ml);
    assert!((5.0..15.001).contains(&taken.aspirated_ml), "{}", taken.aspirated_ml);
    let half_s = f64::from(taken.rate_ml_min) / 60.0 * 30.0 / 60.0;
    let lost = taken.lost_ml - lying.lost_ml;
    assert!((lost / half_s - 50.0 / 30.0).abs() < 1e-3, "{lost} ml in 50 ticks");
    // Without a bed it is gone.
    app.world_mut().despawn(bed);
    app.world_mut().entity_mut(tool).insert(SuctionValve { open: false });
    let before = taken.pooled_ml();
    let after = (0..10).map(|_| tick(&mut app)).last().unwrap();
    assert!(after.gone_ml > 0.0 && (after.pooled_ml() - before).abs() < 1e-12);
}

/// Through half of the lumen flows what the law gives half of the area; of a hole that is small for its supply, half.
#[test]
fn a_clip_half_across_is_misplaced_and_bleeds() {
    for (supply_ml_min, tolerance) in [(600.0, 0.5), (1e7, 1e-2)] {
        let mut app = app();
        let organ = bar(&mut app, VesselEnd::default());
        app.world_mut().get_mut::<Vessel>(organ).unwrap().near.supply_ml_min = supply_ml_min;
        let tool = applier(&mut app);
        app.update();
        sever(&mut app, organ, 0.026);
        app.update();
        app.update();
        let whole = rate(&app);
        fire(&mut app, tool, 0.0121, 0.00398);
        app.update();
        let [(_, clip)] = &clips(&mut app)[..] else { panic!("one clip") };
        let half = rate(&app);
        println!("supply {supply_ml_min}: {whole} ml/min, with a clip that closes {} of the lumen {half}", clip.closes);
        assert!((clip.closes - 0.5).abs() < 0.01, "{}", clip.closes);
        let source = VesselEnd { supply_ml_min, ..ARTERY };
        let by_law = flow_ml_min(&source, f64::from(1.0 - clip.closes) * std::f64::consts::PI * 0.0025f64.powi(2));
        assert!((f64::from(half) / by_law - 1.0).abs() < 1e-3, "{half} {by_law}");
        assert!((half / whole - 0.5).abs() < tolerance);
        assert_eq!(app.world().resource::<ClipReport>().misplaced, 1);
    }
}

#[test]
fn a_clip_that_closes_on_nothing_drops() {
    let mut app = app();
    bar(&mut app, ARTERY);
    let tool = applier(&mut app);
    fire(&mut app, tool, 0.02, 0.05);
    assert!(clips(&mut app).is_empty());
    let mut query = app.world_mut().query::<(&ClipShape, &RigidBody, &RigidPose)>();
    let (shape, body, pose) = query.single(app.world()).unwrap();
    assert_eq!(pose.now.translation, Vec3::new(0.02, 0.004, 0.05).into());
    assert!(body.density_kg_m3 == shape.density_kg_m3 && app.world().resource::<ClipReport>().dropped == 1);
    // Open or closed, nothing more happens; with the cartridge empty nothing at all.
    app.update();
    app.world_mut().get_mut::<ClipApplier>(tool).unwrap().clips = 0;
    fire(&mut app, tool, 0.02, 0.0085);
    assert!(clips(&mut app).is_empty());
    assert_eq!(app.world().resource::<ClipReport>().dropped, 1);
}

/// Relaxes the bar as a net of springs, with ends that stay and its attachments.
fn relax(mesh: &TetMesh, state: &mut TissueState, attachments: &Attachments) {
    let mut edges: Vec<(usize, usize)> = Vec::new();
    for (_, c) in mesh.iter() {
        edges.extend(
            (0..4).flat_map(|i| (0..i).map(move |j| (i, j))).map(|(i, j)| (c[i].index().min(c[j].index()), c[i].index().max(c[j].index()))),
        );
    }
    edges.sort_unstable();
    edges.dedup();
    let rest = |i: usize| mesh.rest(NodeId(i as u32)).as_vec3();
    for _ in 0..60 {
        let mut force = vec![Vec3::ZERO; state.positions.len()];
        for (i, j) in &edges {
            let way = state.positions[*j] - state.positions[*i];
            let pull = way * (1.0 - rest(*i).distance(rest(*j)) / way.length().max(1e-6)) * 10.0;
            force[*i] += pull;
            force[*j] -= pull;
        }
        for a in &attachments.0 {
            let keyhole_whiteboard::Anchor::Space(to) = a.anchor else { continue };
            let at: Vec3 = a.point.iter().map(|(n, w)| state.positions[n.index()] * *w).sum();
            a.point.iter().for_each(|(n, w)| force[n.index()] -= (at - to) / a.compliance_m_n * *w);
        }
        for ((x, f), r) in state.positions.iter_mut().zip(force).zip(mesh.rest_positions()) {
            if (0.001..0.039).contains(&r.x) {
                *x += f * 2e-4;
            }
        }
    }
}

fn settle(app: &mut App, organ: Entity, ticks: u32) {
    for _ in 0..ticks {
        app.update();
        let mut entity = app.world_mut().entity_mut(organ);
        let attachments = entity.get::<Attachments>().unwrap().clone();
        let mesh = entity.get::<TissueMesh>().unwrap().0.clone();
        let mut state = entity.get_mut::<TissueState>().unwrap();
        relax(&mesh, &mut state, &attachments);
    }
}

fn widths(app: &App, clip: &Clip) -> Vec<f32> {
    let state = app.world().get::<TissueState>(clip.organ).unwrap();
    let at = |p: &keyhole_whiteboard::TissuePoint| keyhole_clipping::locate::position(p, &state.positions).unwrap();
    clip.pairs.iter().map(|p| at(&p.upper).distance(at(&p.lower))).collect()
}

/// The clip squeezes soft tissue flat, moves with it, and pulls it nowhere; tetrahedra in its legs are cut, and it holds the same places.
#[test]
fn a_clip_stays_with_its_tissue_when_that_is_cut() {
    let mut app = app();
    let organ = bar(&mut app, VesselEnd::default());
    let tool = applier(&mut app);
    fire(&mut app, tool, 0.0203, 0.0085);
    settle(&mut app, organ, 90);
    let [(entity, clip)] = &clips(&mut app)[..] else { panic!("one clip") };
    let pairs = clip.pairs.len();
    let flat = widths(&app, clip);
    let widest = flat.iter().copied().fold(0.0, f32::max);
    println!("{pairs} pieces, {} mm apart at most, pinch {} N", widest * 1e3, clip.pinch_n());
    assert!(widest < 0.0015 && clip.pinch_n() <= ClipShape::default().most_pinch_n * 1.001 && clip.pinch_n() > 0.01);
    assert!((Vec3::from(clip.pose.translation) - Vec3::new(0.0203, 0.004, 0.0085)).length() < 0.001, "{:?}", clip.pose);
    for tie in &app.world().get::<Attachments>(organ).unwrap().0 {
        assert!(tie.is_tie() && tie.point.iter().map(|(_, w)| w).sum::<f32>().abs() < 1e-6);
    }
    let entity = *entity;
    // Every tetrahedron that has a point of a wall is split in four around its middle.
    let points: Vec<_> = clip.pairs.iter().flat_map(|p| [p.upper.clone(), p.lower.clone()]).collect();
    let before = flat;
    let walls = points.clone();
    app.insert_resource(Blade(Some(Box::new(move |world| split(world, organ, &walls)))));
    app.update();
    let clip = app.world().get::<Clip>(entity).unwrap().clone();
    assert_eq!(clip.pairs.len(), pairs, "no piece is lost");
    assert!(clip.pairs.iter().all(|p| !points.contains(&p.upper)), "every point has a new tetrahedron");
    for (was, is) in before.iter().zip(widths(&app, &clip)) {
        assert!((was - is).abs() < 1e-5, "{was} {is}");
    }
    // The tissue is carried away; the clip goes with it.
    let shift = Vec3::new(0.1, -0.2, 0.05);
    app.world_mut().get_mut::<TissueState>(organ).unwrap().positions.iter_mut().for_each(|x| *x += shift);
    app.update();
    let moved = app.world().get::<Clip>(entity).unwrap().pose;
    assert!((Vec3::from(moved.translation - clip.pose.translation) - shift).length() < 1e-5);
}

/// A grasper takes hold of a clip and pulls. Legs whose tissue is too thick press with the most that they bear, 8 N by 24 pieces each; with n of them on
/// tissue that is n / 3 N, which by Coulomb hold 2 x 0.5 times as much.
#[test]
fn a_clip_slips_off_where_it_is_pulled_harder_than_it_holds() {
    let mut slips_at = Vec::new();
    for crown_z in [0.0085, 0.004] {
        let mut app = app();
        let organ = bar(&mut app, VesselEnd::default());
        let tool = applier(&mut app);
        fire(&mut app, tool, 0.0203, crown_z);
        for _ in 0..30 {
            app.update();
        }
        let [(clip, set)] = &clips(&mut app)[..] else { panic!("one clip") };
        let holds = set.pairs.len() as f32 / 3.0;
        assert!((set.pinch_n() - holds).abs() < 1e-3 * holds, "{} {holds}", set.pinch_n());
        let pads = JawPads { from_m: 0.003, to_m: 0.02, half_width_m: 0.002, closed_gap_m: 0.0003 };
        // From above, its jaws across the crown.
        let turned = |up: f32| {
            Isometry3d::new(Vec3::new(0.0203, 0.014 + up, crown_z), bevy_math::Quat::from_rotation_x(-std::f32::consts::FRAC_PI_2))
        };
        let grasper = app.world_mut().spawn((pads, Jaws { angle_rad: 0.1 }, still(turned(0.0)))).id();
        app.update();
        assert!(app.world().get::<Clip>(*clip).unwrap().held.is_some());
        let mut most = 0.0f32;
        for step in 1..2000u16 {
            let (before, now) = (turned(f32::from(step - 1) * 1e-6), turned(f32::from(step) * 1e-6));
            *app.world_mut().get_mut::<InstrumentPose>(grasper).unwrap() = InstrumentPose { now, before };
            app.update();
            let Some(clip) = app.world().get::<Clip>(*clip) else { break };
            most = most.max(clip.pull_n.y);
        }
        println!("{} pieces hold {most} N, by hand {holds}", set.pairs.len());
        assert!((most / holds - 1.0).abs() < 0.01);
        assert!(app.world().get::<HeldBy>(*clip).is_some_and(|h| h.instrument == grasper));
        assert!(app.world().get::<RigidBody>(*clip).is_some() && app.world().resource::<ClipReport>().slipped == 1);
        app.update();
        assert!(app.world().get::<Attachments>(organ).unwrap().0.is_empty(), "nothing of it is left on the tissue");
        app.world_mut().get_mut::<Jaws>(grasper).unwrap().angle_rad = 0.5;
        app.update();
        assert!(app.world().get::<HeldBy>(*clip).is_none());
        slips_at.push(most);
    }
    assert!(slips_at[1] < 0.6 * slips_at[0], "half across it holds about half: {slips_at:?}");
}

#[test]
fn nothing_is_ambiguous_and_nothing_runs_where_it_is_not_required() {
    let mut app = app();
    app.insert_resource(SceneRequirements::default());
    let tool = applier(&mut app);
    bar(&mut app, ARTERY);
    fire(&mut app, tool, 0.02, 0.0085);
    assert!(clips(&mut app).is_empty() && app.world().get::<ClipApplier>(tool).unwrap().clips == 20);
    assert!(app.get_schedule(bevy_app::FixedUpdate.intern()).is_some());
}
