//! A model chosen in the settings, in an app.

use crate::common::split_edge;
use bevy_app::App;
use bevy_time::{Fixed, Time, TimePlugin, TimeUpdateStrategy};
use keyhole_tissue::beam::{beam_material, block};
use keyhole_tissue::{
    Capsule, Constraints, TeschnerSettings, TissueBody, TissueModel, TissuePlugin, TissueReport, TissueSettings, VbdSettings, XpbdSettings,
};
use keyhole_whiteboard::{Organ, SceneRequirements, TissueMesh, TissueState, TopologyChanged, WhiteboardPlugin};

/// Every model steps an organ with a capsule, adopts a cut in the tick in which it happens, and goes on.
#[test]
fn every_model_can_be_chosen() {
    let springs = XpbdSettings { constraints: Constraints::DistanceVolume, ..Default::default() };
    for model in [
        TissueModel::Implicit,
        TissueModel::Teschner(TeschnerSettings::default()),
        TissueModel::Xpbd(XpbdSettings::default()),
        TissueModel::Xpbd(springs),
        TissueModel::Vbd(VbdSettings::default()),
    ] {
        let mut app = App::new();
        app.add_plugins((TimePlugin, WhiteboardPlugin, TissuePlugin));
        app.insert_resource(TimeUpdateStrategy::FixedTimesteps(1));
        app.insert_resource(Time::<Fixed>::from_hz(60.0));
        app.insert_resource(SceneRequirements { tissue: true, ..Default::default() });
        let capsule = Capsule { young_modulus_pa: 1e5, ..Default::default() };
        app.insert_resource(TissueSettings { model, capsule: Some(capsule), ..Default::default() });
        app.update();
        let mut mesh = block([3, 3, 3], [0.03; 3]);
        let organ = app.world_mut().spawn((Organ { name: "block".into() }, beam_material(), TissueMesh(mesh.clone()))).id();
        app.update();
        let area = |app: &App| app.world().get::<TissueBody>(organ).unwrap().model.membrane().unwrap().area();
        let before = area(&app);
        assert_eq!(app.world().get::<TissueBody>(organ).unwrap().model.model(), model);

        let (_, c) = mesh.iter().nth(20).unwrap();
        split_edge(&mut mesh, c[0], c[1], 0.4);
        let delta = mesh.take_delta();
        app.world_mut().get_mut::<TissueMesh>(organ).unwrap().0 = mesh.clone();
        app.world_mut().write_message(TopologyChanged { organ, delta });
        for _ in 0..5 {
            app.update();
        }
        assert!((area(&app) / before - 1.0).abs() < 1e-9, "{model:?}");
        assert_eq!(app.world().resource::<TissueReport>().adoptions, 1);
        assert!(app.world().resource::<TissueReport>().quarantined.is_empty(), "{model:?}");
        let state = app.world().get::<TissueState>(organ).unwrap();
        let fallen: Vec<f32> = mesh.nodes().map(|n| mesh.rest(n).y as f32 - state.position(n).y).collect();
        assert!(fallen.iter().all(|f| *f > 0.03 && *f < 0.1), "{model:?}: {fallen:?}");
    }
}
