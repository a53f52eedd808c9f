//! The paper's whiteboard: the shared state of the simulator, and nothing else.
//!
//! An organ is an entity. Each thing has one writer (see the doc of each type); everybody may read. What many must react to in order is
//! a message; what is a rare event of one entity is an entity event with observers.

pub mod attachment;
pub mod blood;
pub mod checkpoint;
pub mod clip;
pub mod contact;
pub mod control;
pub mod cutting;
pub mod device;
pub mod exchange;
pub mod gesture;
pub mod grasp;
pub mod ids;
pub mod input;
pub mod instrument;
pub mod optics;
pub mod organ;
pub mod rigid;
pub mod scene;
pub mod suture;
pub mod tick;

pub use attachment::{Anchor, Attachment, Attachments, TissuePoint};
pub use blood::{BloodPool, Suction, SuctionValve};
pub use checkpoint::{Checkpoint, StateOf, StateRegistry, StateRestored};
pub use clip::{BleedReport, BleedSite, Clip, ClipApplier, ClipPair, ClipReport, ClipShape, Vessel, VesselEnd};
pub use contact::{Contact, Contacts, Obstacle, StaticSurface, SurfaceFriction, ToolContacts, ToolTouch, ToolTouched};
pub use control::{GlobalView, KeyMap, PointerClaims, SimulationControl, ViewMode};
pub use cutting::{CutMethod, CutPattern, CutSettings, CutStatus};
pub use device::{AxisInput, DeviceCondition, DeviceHand, DeviceHands, DeviceReport, DeviceStatus, ToolForce};
pub use exchange::{Exchange, ExchangeStage, Tray};
pub use gesture::GestureSystems;
pub use grasp::{Bruises, Grasp, GraspReport, JawPads, PinchLimit};
pub use ids::SimulationIds;
pub use input::{HandInput, Moved, ScriptClock};
pub use instrument::{
    Blade, CutTrigger, CuttingLine, Endoscope, Hand, Instrument, InstrumentKind, InstrumentPose, Jaws, Joint, LineShape, PartMesh, Port,
    ToolModel, ToolPart,
};
pub use optics::ScopeOptics;
pub use organ::{Anatomy, FragmentDetached, FreedFrom, Organ, OrganMaterial, OrganMaterials, TissueMesh, TissueState, TopologyChanged};
pub use rigid::{HeldBy, RigidBody, RigidFragments, RigidMass, RigidPose, RigidQuarantined, RigidReport, RigidShape, Rigidified};
pub use scene::{Gravity, SceneCleared, SceneRequirements};
pub use suture::{
    Bite, Bites, Hole, HoleKind, Knot, Knots, Needle, NeedleGrip, SutureReport, TearResistance, Thread, ThreadGrip, TornBite,
};
pub use tick::{SenseSystems, TickCost, TickSystems, WhiteboardPlugin};
