//! The mistakes that authors make, each alone in a scene that is sound without it, and what the checker says.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

use keyhole_scene::check::check_text;
use std::path::Path;

const SOUND: &str = r#"(
    version: 1,
    name: "Sheet",
    gravity: (0.0, -9.81, 0.0),
    organs: [
        (
            name: "sheet",
            shape: Block(size: (0.08, 0.002, 0.06), cells: (16, 1, 12)),
            materials: [(name: "gauze", young_modulus_pa: 200000.0, poisson_ratio: 0.3, density_kg_m3: 600.0, inside: (0.8, 0.8, 0.7), surface: (0.9, 0.9, 0.8))],
            attachments: [(region: HalfSpace(point: (0.03, 0.0, 0.0), normal: (1.0, 0.0, 0.0)), compliance_m_n: 0.0)],
        ),
    ],
    anatomy: [(name: "table", shape: Box(size: (0.1, 0.01, 0.1)), colour: (0.2, 0.4, 0.4), transform: (translation: (0.0, -0.04, 0.0)), solid: true)],
    ports: [
        (name: "right", position: (0.05, 0.14, 0.06), inward: (-0.3, -0.9, -0.3)),
        (name: "left", position: (-0.08, 0.13, 0.06), inward: (0.45, -0.85, -0.25)),
        (name: "optic", position: (0.0, 0.1, 0.13), inward: (0.0, -0.6, -0.8)),
    ],
    instruments: [
        (kind: Scissors, hand: Right, port: "right"),
        (kind: Grasper, hand: Left, port: "left"),
    ],
    endoscope: (port: "optic", direction_of_view_deg: 30.0, angle_of_view_deg: 70.0),
    cut: (method: Hybrid, snap: 0.2),
    demonstration: (
        seconds: 2.0,
        hands: [(hand: Right, keys: [(time_s: 0.0, tip: (0.0, 0.05, 0.0)), (time_s: 1.0, tip: (0.0, 0.01, 0.0), grip: 1.0)])],
    ),
)"#;

/// What goes wrong, what stands in the sound scene, and what somebody wrote instead.
const MISTAKES: [(&str, &str, &str); 24] = [
    ("a comma forgotten", "name: \"Sheet\",", "name: \"Sheet\""),
    ("a bracket too few", "    ),\n)", "    ,\n)"),
    ("a field misspelt", "attachments: [(region", "atachments: [(region"),
    ("a kind that there is not", "kind: Scissors", "kind: Scisors"),
    ("a number in quotes", "young_modulus_pa: 200000.0", "young_modulus_pa: \"200 kPa\""),
    ("two numbers for three", "gravity: (0.0, -9.81, 0.0)", "gravity: (0.0, -9.81)"),
    ("another version", "version: 1,", "version: 3,"),
    ("stiffness in kPa, negative", "young_modulus_pa: 200000.0", "young_modulus_pa: -200.0"),
    ("incompressible", "poisson_ratio: 0.3", "poisson_ratio: 0.5"),
    ("a mesh that is not there", "shape: Block(size: (0.08, 0.002, 0.06), cells: (16, 1, 12)),", "mesh: \"meshes/sheet.vtu\","),
    ("neither mesh nor shape", "shape: Block(size: (0.08, 0.002, 0.06), cells: (16, 1, 12)),", ""),
    ("no such port", "port: \"right\"", "port: \"rihgt\""),
    ("two in one hand", "hand: Left, port: \"left\"", "hand: Right, port: \"left\""),
    ("a blade on a grasper", "kind: Grasper,", "kind: Grasper, blade: (length_mm: 10),"),
    ("snapping too far", "snap: 0.2", "snap: 0.7"),
    ("a direction that is none", "normal: (1.0, 0.0, 0.0)", "normal: (0.0, 0.0, 0.0)"),
    ("time that goes back", "time_s: 1.0", "time_s: -1.0"),
    (
        "a goal for an organ that there is not",
        "    endoscope:",
        "    task: (goals: [(name: \"cut\", want: CutThrough(organ: \"shet\"))]),\n    endoscope:",
    ),
    (
        "a goal that there is not",
        "    endoscope:",
        "    task: (goals: [(name: \"cut\", want: CutTrough(organ: \"sheet\"))]),\n    endoscope:",
    ),
    (
        "a peg that is a table",
        "    endoscope:",
        "    task: (goals: [(name: \"put\", want: Round(organ: \"sheet\", pegs: [\"table\"]))]),\n    endoscope:",
    ),
    (
        "a step without guidance",
        "    endoscope:",
        "    task: (goals: [(name: \"cut\", want: CutThrough(organ: \"sheet\"), step: 2)]),\n    endoscope:",
    ),
    (
        "scissors that are to hold",
        "    endoscope:",
        "    task: (goals: [(name: \"hold\", want: Held(organ: \"sheet\", hands: [Right]))]),\n    endoscope:",
    ),
    (
        "proficient after the cutoff",
        "    endoscope:",
        "    task: (goals: [(name: \"cut\", want: CutThrough(organ: \"sheet\"))], score: Own(cutoff_s: 20, proficient_s: 30)),\n    endoscope:",
    ),
    ("a needle in scissors", "    endoscope:", "    sutures: [(held_by: Right)],\n    endoscope:"),
];

#[test]
fn each_mistake_is_named_with_its_place_and_what_to_do() {
    let check = |text: &str| check_text(Path::new("sheet.scene.ron"), text);
    assert_eq!(check(SOUND), []);
    let report = MISTAKES.map(|(what, from, to)| {
        assert_eq!(SOUND.matches(from).count(), 1, "{what}: `{from}` stands once in the sound scene");
        let problems: Vec<String> = check(&SOUND.replace(from, to)).iter().map(ToString::to_string).collect();
        assert!(!problems.is_empty(), "nobody notices {what}");
        let line = SOUND[..SOUND.find(from).unwrap()].lines().count().max(1);
        assert!(problems.iter().any(|p| (line..line + 3).any(|l| p.contains(&format!(":{l}:")))), "{what} is in line {line}: {problems:?}");
        format!("{what}:\n{}", problems.join("\n"))
    });
    insta::assert_snapshot!(report.join("\n\n"));
}
