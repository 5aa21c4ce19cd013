"""The user's meshes: holes stay free, pushed meshes come to rest, and bad files are refused."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from gym_open.envs.options import CameraOptions, MeshObject, ObjectOptions, WorldOptions
from gym_open.envs.physics import meshes
from gym_open.envs.physics import model as m
from gym_open.envs.physics.meshes import MeshError, mesh_shape
from gym_open.envs.physics.sleep import AWAKE, set_asleep
from gym_open.envs.puzzles import Placement, Puzzle, PuzzleError, arranged
from gym_open.envs.world import World

EAST = 1
BALL = ObjectOptions(size=0.04)


def extruded(outline: np.ndarray, fan: list[tuple[int, int, int]], height: float) -> trimesh.Trimesh:
    """A closed mesh over an outline (n, 2), counter-clockwise, that the triangles of `fan` fill."""
    n = len(outline)
    vertices = np.vstack([np.c_[outline, np.zeros(n)], np.c_[outline, np.full(n, height)]])
    faces = [(c, b, a) for a, b, c in fan] + [(a + n, b + n, c + n) for a, b, c in fan]
    for i in range(n):
        j = (i + 1) % n
        faces += [(i, j, j + n), (i, j + n, i + n)]
    return trimesh.Trimesh(vertices, faces)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An L, 12 cm long and 4 cm thick, and a ring with a hole 6.4 cm wide."""
    path = tmp_path_factory.mktemp("meshes")
    outline = np.array([(0, 0), (0.12, 0), (0.12, 0.04), (0.04, 0.04), (0.04, 0.12), (0, 0.12)])
    extruded(outline, [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)], 0.06).export(path / "l.stl")
    trimesh.creation.torus(0.05, 0.018, major_sections=12, minor_sections=6).export(path / "ring.obj")
    return path


def world_with(mesh: MeshObject, *objects: tuple, **options: object) -> World:
    world = World(WorldOptions(meshes=(mesh,), objects={"push": BALL}, **options))  # pyright: ignore[reportArgumentType]
    world.load(Puzzle("sandbox", arranged([Placement(*item) for item in objects])))
    return world


def depth_of_ball(world: World, place: tuple[float, float]) -> float:
    """Depth of the overlap of a 4 cm ball on the table with the mesh, at this position relative to the mesh's cell."""
    index, mesh = (next(i for i, n in enumerate(world.inventory) if n.startswith(k)) for k in ("push_0", "mesh:"))
    poses = world.data.qpos.reshape(-1, 7)
    poses[index, :2] = poses[mesh, :2] + place
    poses[index, 2] = 0.02
    set_asleep(world.model, world.data, np.full(len(world.inventory), AWAKE))
    mujoco.mj_forward(world.model, world.data)
    contact = world.data.contact
    ball = (contact.geom == world.model.geom("push_0").id).any(axis=1)
    aside = ~(contact.geom == world.model.geom("ground").id).any(axis=1)
    return -float(contact.dist[ball & aside].min(initial=0))


def depth_in_hull(mesh: trimesh.Trimesh, place: tuple[float, float, float]) -> float:
    """The same for MuJoCo's own collision of the mesh, which uses the convex hull."""
    vertices = " ".join(map(str, mesh.vertices.ravel()))
    text = f"""<mujoco><asset><mesh name="m" vertex="{vertices}"/></asset><worldbody>
        <geom type="mesh" mesh="m"/><body pos="{place[0]} {place[1]} {place[2]}"><freejoint/><geom size="0.02"/></body>
        </worldbody></mujoco>"""
    data = mujoco.MjData(model := mujoco.MjModel.from_xml_string(text))
    mujoco.mj_forward(model, data)
    return -float(data.contact.dist.min(initial=0))


def test_the_hole_of_a_ring_is_free(folder: Path) -> None:
    world = world_with(
        MeshObject(name="ring", file=str(folder / "ring.obj")), ("agent", 1, 1), ("mesh:ring", 8, 4), ("push", 3, 3)
    )
    assert depth_of_ball(world, (0, 0)) == 0
    assert depth_of_ball(world, (0.008, 0)) == 0
    assert depth_of_ball(world, (0.05, 0)) > 0.02  # but the ring itself is solid
    assert depth_of_ball(world, (0, -0.05)) > 0.02
    assert depth_in_hull(trimesh.load_mesh(folder / "ring.obj"), (0, 0, 0)) > 0.01


def test_the_notch_of_an_l_is_free(folder: Path) -> None:
    world = world_with(
        MeshObject(name="l", file=str(folder / "l.stl")), ("agent", 1, 1), ("mesh:l", 8, 4), ("push", 3, 3)
    )
    assert depth_of_ball(world, (0.005, 0.005)) == 0  # its corner is at (−0.02, −0.02) from the middle of the box
    assert depth_of_ball(world, (-0.04, 0.04)) > 0.01
    assert depth_of_ball(world, (0.04, -0.04)) > 0.01
    assert depth_in_hull(trimesh.load_mesh(folder / "l.stl"), (0.065, 0.065, 0.02)) > 0.01


def test_mass_and_inertia_are_the_bodys(folder: Path) -> None:
    world = world_with(MeshObject(name="l", file=str(folder / "l.stl"), mass=8.0), ("agent", 1, 1), ("mesh:l", 8, 4))
    solid = trimesh.load_mesh(folder / "l.stl")
    body = world.model.body("mesh:l_0")
    assert body.mass[0] == pytest.approx(8.0)
    density = 8.0 / solid.volume
    expected = np.linalg.eigvalsh(solid.moment_inertia * density)
    np.testing.assert_allclose(np.sort(body.inertia), expected, rtol=0.02)
    middle = solid.center_mass - solid.bounds.mean(axis=0)
    np.testing.assert_allclose(body.ipos, middle, atol=1e-3)


def test_it_is_pushed_and_comes_to_rest(folder: Path) -> None:
    mesh = MeshObject(name="ring", file=str(folder / "ring.obj"), mass=8.0)
    world = world_with(mesh, ("agent", 8, 2), ("mesh:ring", 8, 4))
    index = world.inventory.index("mesh:ring_0")
    start = world.object_state()[index, :3]
    assert world.data.tree_asleep[index] == index
    outcomes = [world.step(EAST) for _ in range(2)]
    contacts = [contact for outcome in outcomes for contact in outcome.contacts]
    assert {contact.a for contact in contacts} | {contact.b for contact in contacts} == {"agent", "mesh:ring_0"}
    assert world.object_state()[index, 7] > 0.5
    world.advance(1000)
    state = world.object_state()[index]
    assert state[0] > start[0] + 0.1
    assert not state[7:].any()
    assert world.data.tree_asleep[index] >= 0


def test_it_lies_where_it_was_put(folder: Path) -> None:
    ring = trimesh.load_mesh(folder / "ring.obj")
    lying = ring.vertices[:, 2].copy()
    ring.apply_transform(trimesh.transformations.rotation_matrix(1.2, (1, 0, 0)))  # tilted: it falls over
    ring.export(folder / "leaning.stl")
    shape = mesh_shape(MeshObject(name="ring", file=str(folder / "leaning.stl")))
    np.testing.assert_allclose(shape.extents[2], np.ptp(lying), atol=2e-3)
    world = world_with(MeshObject(name="ring", file=str(folder / "leaning.stl")), ("agent", 8, 1), ("mesh:ring", 8, 4))
    index = world.inventory.index("mesh:ring_0")
    before = world.object_state()[index]
    assert before[2] == pytest.approx(np.ptp(lying) / 2, abs=1e-3)
    world.step(3)  # the agent moves away from it
    np.testing.assert_array_equal(world.object_state()[index], before)


def test_the_visible_shape_is_the_mesh_itself(folder: Path) -> None:
    above = CameraOptions(position=(0, 0, 0.4), direction=(90, 0, 0))
    mesh = MeshObject(name="ring", file=str(folder / "ring.obj"), colour=(10, 90, 200))
    world = world_with(mesh, ("agent", 1, 1), ("mesh:ring", 7, 4), camera=above)
    x, y, z = world.object_state()[world.inventory.index("mesh:ring_0"), :3]
    seen = world.segmentation() == world.model.geom("mesh:ring_0").id

    def pixel(dx: float, dy: float) -> tuple[int, int]:
        half = np.tan(np.deg2rad(30)) * (0.4 - z)
        return int(42 - 42 * (y + dy) / half), int(42 + 42 * (x + dx) / half)

    assert not seen[pixel(0, 0)]
    for way in ((0.05, 0), (-0.05, 0), (0, 0.05), (0, -0.05)):
        assert seen[pixel(*way)]
    assert world.observe()[pixel(0.05, 0)].argmax() == 2


def test_the_text_alone_makes_the_same_model(folder: Path) -> None:
    options = WorldOptions(meshes=(MeshObject(name="l", file=str(folder / "l.stl"), count=2),))
    text = m.model_xml(options)
    assert "file=" not in text
    model, world = mujoco.MjModel.from_xml_string(text), World(options)
    assert world.inventory[-2:] == ("mesh:l_0", "mesh:l_1")
    np.testing.assert_array_equal(model.mesh_vert, world.model.mesh_vert)
    np.testing.assert_array_equal(model.body_inertia, world.model.body_inertia)


def test_cutting_gives_the_same_pieces_again(folder: Path) -> None:
    mesh = MeshObject(name="l", file=str(folder / "l.stl"))
    first = mesh_shape(mesh)
    assert mesh_shape(mesh) is first
    meshes._shape.cache_clear()
    again = mesh_shape(mesh)
    assert again is not first
    for one, other in zip(first.pieces, again.pieces, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("kind", ["obj", "stl", "ply", "glb"])
def test_formats(tmp_path: Path, kind: str) -> None:
    box = trimesh.creation.box((0.05, 0.06, 0.08))
    box.visual = trimesh.visual.ColorVisuals(box, vertex_colors=(10, 200, 30, 255))  # pyright: ignore
    box.export(tmp_path / f"box.{kind}")
    shape = mesh_shape(MeshObject(name="box", file=str(tmp_path / f"box.{kind}"), scale=1.5))
    expected = (0.05, 0.08, 0.06) if kind == "glb" else (0.05, 0.06, 0.08)  # y points up in glTF
    np.testing.assert_allclose(shape.extents, 1.5 * np.array(expected), atol=1e-3)
    assert shape.colour == ((160, 160, 160) if kind == "stl" else (10, 200, 30))
    assert sum(shape.shares) == pytest.approx(1)


def test_parts_that_overlap_are_cut_each_on_its_own(tmp_path: Path) -> None:
    parts = [trimesh.creation.box((0.06, 0.03, 0.05)), trimesh.creation.box((0.03, 0.06, 0.05))]
    trimesh.util.concatenate(parts).export(tmp_path / "cross.obj")  # pyright: ignore[reportAttributeAccessIssue]
    shape = mesh_shape(MeshObject(name="cross", file=str(tmp_path / "cross.obj")))
    assert sorted(np.ptp(piece, axis=0).round(4).tolist() for piece in shape.pieces) == [
        [0.03, 0.06, 0.05],
        [0.06, 0.03, 0.05],
    ]
    assert shape.shares == pytest.approx((0.5, 0.5))


def refused(path: Path, said: str, scale: float = 1.0) -> None:
    with pytest.raises(MeshError, match=said) as caught:
        mesh_shape(MeshObject(name="thing", file=str(path), scale=scale))
    assert "thing" in str(caught.value)
    assert path.name in str(caught.value)


def test_bad_files_are_refused_by_name(tmp_path: Path) -> None:
    refused(tmp_path / "none.stl", r"cannot be read \(No such file")
    refused(tmp_path / "thing.step", r"expected a file named \.obj, \.stl, \.ply, \.glb")
    for kind in ("obj", "stl", "ply", "glb"):
        (tmp_path / f"text.{kind}").write_text("this is no mesh")
        refused(tmp_path / f"text.{kind}", f"not a {kind.upper()} mesh")
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.05)
    trimesh.Trimesh(ball.vertices, ball.faces[3:]).export(tmp_path / "open.ply")
    refused(tmp_path / "open.ply", "not watertight")
    trimesh.creation.box((0.3, 0.1, 0.1)).export(tmp_path / "big.stl")
    refused(tmp_path / "big.stl", r"0.3 × 0.1 × 0.1 m is larger than a cell of 0.141 m; use `scale` 0.459 or less")
    refused(tmp_path / "big.stl", r"smaller than 0.04 m; use `scale` 0.135 or more", scale=0.1)
    assert mesh_shape(MeshObject(name="thing", file=str(tmp_path / "big.stl"), scale=0.459)).extents[0] < 0.14
    trimesh.creation.icosphere(subdivisions=6, radius=0.05).export(tmp_path / "fine.stl")
    refused(tmp_path / "fine.stl", "81920 faces, at most 20000")


def test_a_puzzle_must_not_ask_for_more_than_the_world_has(folder: Path) -> None:
    puzzle = Puzzle("sandbox", arranged([Placement("agent", 1, 1), Placement("mesh:l", 8, 4)]))
    with pytest.raises(PuzzleError, match="'mesh:l' than this world's 0"):
        World().load(puzzle)
    world = World(WorldOptions(meshes=(MeshObject(name="l", file=str(folder / "l.stl")),)))
    world.load(puzzle)
    with pytest.raises(PuzzleError, match="'mesh:l' than this world's 1"):
        world.load(Puzzle("sandbox", arranged([*puzzle.objects, Placement("mesh:l", 3, 4)])))
    assert world.puzzle == puzzle  # the world is unchanged
