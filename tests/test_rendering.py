"""Pictures: what stands where, and that the same scenes give the same pixels."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import NO_PATH, SIZE, camera_of, coloured, picture, scene

from formation_env.env import FormationEnv
from formation_env.interface.faces import path_times
from formation_env.paths.references import Floats
from formation_env.rendering import Renderer, _pixels
from formation_env.rendering.camera import Follow, look, project
from formation_env.rendering.geometry import (
    circle,
    dashes,
    floor_grid,
    grid_spacing,
    quadrotors,
    rotations,
)
from formation_env.rendering.style import FAR, FOLLOWERS, LEADER

pygame = pytest.importorskip("pygame")
painter = pytest.importorskip("formation_env.rendering.painter")
Painter, _widths = painter.Painter, painter._widths

coordinates = st.floats(-50.0, 50.0)
points = st.tuples(coordinates, coordinates, st.floats(-30.0, 0.0)).map(np.array)


# -- projection -----------------------------------------------------------------------------------


@given(points, st.floats(1.0, 100.0), st.floats(0.1, 3.0))
def test_the_axis_of_the_camera_meets_the_picture_in_its_middle(
    aim: Floats, distance: float, share: float
) -> None:
    camera = look(aim, distance, SIZE)
    pixel, depth = project(camera, camera.eye + share * (aim - camera.eye))
    assert np.allclose(pixel, [160.0, 90.0], atol=1e-6)
    assert depth == pytest.approx(share * distance)


@given(points, st.floats(2.0, 100.0), st.floats(0.3, 3.0), st.floats(0.0, 6.2))
def test_apparent_size_falls_as_one_over_depth(
    aim: Floats, distance: float, share: float, angle: float
) -> None:
    camera = look(aim, distance, SIZE)
    across = 0.1 * (np.cos(angle) * camera.axes[0] + np.sin(angle) * camera.axes[1])
    ends = camera.eye + share * (aim - camera.eye) + np.stack([-across, across])
    pixels, depth = project(camera, ends)
    length = float(np.linalg.norm(pixels[1] - pixels[0]))
    assert length * depth[0] == pytest.approx(0.2 * camera.focal, rel=1e-9)


@given(points, points, st.floats(1.0, 100.0), st.floats(0.01, 1.0))
def test_higher_is_higher_and_east_is_to_the_right(
    aim: Floats, point: Floats, distance: float, step: float
) -> None:
    camera = look(aim, distance, SIZE)
    # Near the axis: perspective tilts everything at the border of a picture.
    point = aim + 0.05 * distance * point / 100.0
    steps = point + step * distance * np.array([[0, 0, 0], [0, 0, -0.1], [0, 0.1, 0], [0.1, 0, 0]])
    here, up, east, north = project(camera, steps)[0]
    assert up[1] < here[1]
    assert east[0] > here[0]
    assert north[1] < here[1]


@given(points, st.floats(0.2, 40.0), st.integers(0, 2**31))
def test_the_camera_shows_every_vehicle(middle: Floats, spread: float, seed: int) -> None:
    cloud = middle + spread * np.random.default_rng(seed).uniform(-1.0, 1.0, (7, 3))
    cloud[:, 2] = np.minimum(cloud[:, 2], 0.0)
    pixels, depth = project(Follow().update(0.0, cloud, SIZE), cloud)
    assert (depth > 0.0).all()
    assert (pixels >= 0.0).all() and (pixels <= np.array(SIZE)).all()


def test_the_camera_follows_smoothly_and_arrives() -> None:
    near, far = np.array([[0.0, 0.0, -1.5], [1.0, 1.0, -1.5]]), np.array([[0.0, 9.0, -1.5]] * 2)
    follow = Follow()
    eyes = [follow.update(0.0, near, SIZE).eye]
    eyes += [follow.update(0.02 * k, far, SIZE).eye for k in range(1, 600)]
    goal = Follow().update(0.0, far, SIZE).eye
    left = np.linalg.norm(np.array(eyes) - goal, axis=1)
    assert (np.diff(left) < 0.0).all()
    assert left[1] > 0.9 * left[0]
    assert left[-1] < 1e-3
    # The filter is in simulated time: one large step is as many small ones.
    follow.clear()
    follow.update(0.0, near, SIZE)
    assert np.allclose(follow.update(0.02 * 599, far, SIZE).eye, eyes[-1], atol=1e-9)


# -- geometry -------------------------------------------------------------------------------------


def test_rotations_agree_with_scipy() -> None:
    rotation = pytest.importorskip("scipy.spatial.transform").Rotation
    q = np.random.default_rng(0).normal(size=(20, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    expected = rotation.from_quat(q[:, [1, 2, 3, 0]]).as_matrix()
    assert np.allclose(rotations(q), expected, atol=1e-14)


def test_rotor_discs_are_circles_across_the_thrust() -> None:
    rng = np.random.default_rng(1)
    q = rng.normal(size=(5, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    shapes = quadrotors(rng.normal(size=(5, 3)), q, 0.14, 12)
    spokes = shapes.rotors - shapes.hubs[:, :, None]
    assert np.allclose(np.einsum("nrki,ni->nrk", spokes, shapes.up), 0.0, atol=1e-14)
    assert np.allclose(np.linalg.norm(spokes, axis=-1), np.linalg.norm(spokes[0, 0, 0]))
    # Seen from above, the rotors are numbered to the left round the hull, the first to the right
    # of the nose.
    ahead = (shapes.nose - shapes.hull.mean(axis=1))[:, None]
    right = np.cross(-shapes.up, ahead[:, 0])[:, None]
    arms = shapes.hubs - shapes.hull.mean(axis=1)[:, None]
    assert (np.sign((arms * ahead).sum(-1)) == [1, 1, -1, -1]).all()
    assert (np.sign((arms * right).sum(-1)) == [1, -1, -1, 1]).all()


@given(points, st.floats(0.5, 500.0))
def test_the_grid_lies_on_whole_multiples_of_its_spacing(middle: Floats, distance: float) -> None:
    pieces, axis = floor_grid(middle, distance)
    spacing = grid_spacing(distance)
    cells = pieces[..., :2] / spacing
    assert np.allclose(cells, np.round(cells), atol=1e-6)
    assert (pieces[..., 2] == 0.0).all()
    assert np.allclose(pieces[axis == 1][..., 1], 0.0) and np.allclose(pieces[axis == 2][..., 0], 0)
    assert 0.1 * distance < spacing < 0.3 * distance


def test_dashes_lie_on_the_path_and_leave_gaps() -> None:
    path = 3.0 * circle(720)
    pieces = dashes(path, 5.0)
    assert np.allclose(np.linalg.norm(pieces, axis=-1), 3.0, atol=1e-3)
    drawn = np.linalg.norm(pieces[:, 1] - pieces[:, 0], axis=1).sum()
    assert drawn / (6.0 * np.pi) == pytest.approx(1.0 / 1.8, rel=0.02)
    for empty in (NO_PATH, path[:1], np.zeros((50, 3))):
        assert len(dashes(empty, 5.0)) == 0


# -- pictures -------------------------------------------------------------------------------------


@pytest.mark.parametrize("east", [0.0, -7.3])
def test_every_vehicle_appears_where_the_projection_says(east: float) -> None:
    s = scene(followers=2, east=east)
    frame = picture(s, size=(960, 540))
    pixels, _ = project(camera_of(s, (960, 540)), s.positions)
    for pixel, colour in zip(pixels, (LEADER, *FOLLOWERS), strict=False):
        found = coloured(frame, colour)
        found = found[(found > [190.0, 80.0]).any(axis=1)]  # outside the text
        assert len(found) > 60
        assert np.abs(np.median(found, axis=0) - pixel).max() < 25.0


def test_attitude_is_seen() -> None:
    s = scene()
    height = []
    for angle in (0.0, 0.9):
        roll = s.attitudes.copy()
        roll[0] = [np.cos(angle / 2), np.sin(angle / 2), 0.0, 0.0]
        found = coloured(picture(s._replace(attitudes=roll), size=(960, 540)), LEADER)
        height.append(np.ptp(found[:, 1]))
    # Banked to the right, one pair of rotors is well above the other.
    assert height[1] > 1.5 * height[0]


@pytest.mark.parametrize(("share", "leader_seen"), [(0.7, True), (1.4, False)])
def test_the_nearer_vehicle_hides_the_farther(share: float, leader_seen: bool) -> None:
    s = scene(followers=1)
    camera = look(s.positions[1], 3.4, (960, 540))
    # Leader and follower on one ray: the axis of the camera.
    leader = camera.eye + share * (s.positions[1] - camera.eye)
    s = s._replace(positions=np.stack([leader, s.positions[1]]))
    surface = Painter((960, 540)).paint(camera, s, s.positions[None])
    frame = pygame.surfarray.array3d(surface).swapaxes(0, 1).astype(np.int64)
    hull = frame[267:274, 477:484]
    seen, hidden = (LEADER, FOLLOWERS[0]) if leader_seen else (FOLLOWERS[0], LEADER)
    assert len(coloured(hull, seen)) > 10
    assert len(coloured(hull, hidden)) == 0


def test_shadow_lies_under_the_vehicle() -> None:
    s = scene()
    frame = picture(s, size=(960, 540))
    spot = project(camera_of(s, (960, 540)), s.positions * [1.0, 1.0, 0.0])[0]
    for x, y in spot.round().astype(int):
        floor = frame[y - 3 : y + 4, x + 60 : x + 120].mean()
        assert frame[y - 3 : y + 4, x - 3 : x + 4].mean() < floor - 20.0


def test_slot_is_joined_to_its_follower() -> None:
    s = scene(followers=1)
    away = s._replace(slots=s.slots + np.array([0.0, 1.2, 0.0]))
    camera = camera_of(away, (960, 540))
    middle = project(camera, 0.5 * (away.slots + away.positions[1:]))[0][0]
    found = coloured(picture(away, size=(960, 540)), FOLLOWERS[0])
    assert np.linalg.norm(found - middle, axis=1).min() < 4.0


def test_trails_are_drawn_and_forgotten() -> None:
    flight = [scene(time=0.04 * k, east=0.03 * k) for k in range(40)]
    renderer = Renderer("rgb_array", 50.0, SIZE)
    frames = [renderer.draw(s) for s in flight]
    renderer.clear()
    fresh = renderer.draw(flight[-1])
    assert np.array_equal(fresh, picture(flight[-1]))
    assert frames[-1] is not None and not np.array_equal(frames[-1], fresh)
    # Time that runs backwards is a new episode whose reset nobody announced.
    renderer.draw(flight[5])
    assert np.array_equal(renderer.draw(flight[0]), picture(flight[0]))


def test_waiting_for_the_trigger_is_said() -> None:
    waiting, flying = picture(scene(started=False)), picture(scene())
    rows, columns = np.nonzero(np.abs(waiting - flying).max(axis=-1))
    assert len(rows) > 100
    assert rows.max() < SIZE[1] // 4 and abs(np.mean(columns) - SIZE[0] / 2) < 15.0


def test_same_scenes_same_pixels_and_fresh_arrays() -> None:
    flight = [scene(time=0.02 * k, east=0.01 * k) for k in range(20)]
    assert np.array_equal(picture(*flight), picture(*flight))
    renderer = Renderer("rgb_array", 50.0, SIZE)
    first = renderer.draw(flight[0])
    assert first is not None and first.dtype == np.uint8 and first.flags.writeable
    copy = first.copy()
    renderer.draw(flight[-1])
    assert np.array_equal(first, copy)


@pytest.mark.parametrize("followers", [1, 8, 9, 256])
def test_any_number_of_followers(followers: int) -> None:
    s = scene(followers=followers)
    path = np.linspace([0.0, 0.0, -1.5], [1e4, 0.0, -1.5], 500)  # to far beyond the horizon
    later = scene(followers=followers, time=0.1, east=0.2)
    outside_text = picture(s._replace(path=path), later, size=(960, 540))
    outside_text[:190, :260] = FAR
    for colour in FOLLOWERS[: min(followers, 6)]:
        assert len(coloured(outside_text, colour)) > 5
    # The number is written: both errors are large enough for the same red.
    errors = []
    for error in (0.6, 0.7):
        slots = s.slots.copy()
        slots[0, 2] += error  # within the height that the camera shows anyway
        errors.append(picture(s._replace(slots=slots))[:60, :110])
    assert (errors[0] != errors[1]).any()


def test_another_renderer_may_quit_pygame() -> None:
    renderer = Renderer("rgb_array", 50.0, SIZE)
    before = renderer.draw(scene())
    pygame.quit()
    assert np.array_equal(renderer.draw(scene()), before)
    pygame.quit()
    pygame.font.init()  # by the other, so that only the font is stale
    assert np.array_equal(renderer.draw(scene()), before)


def test_the_array_has_the_colours_of_the_surface() -> None:
    surface = pygame.Surface((3, 2), 0, 32)
    surface.set_at((2, 1), (10, 20, 30))
    found = _pixels(surface)
    assert found.shape == (2, 3, 3) and found.flags.c_contiguous
    assert found[1, 2].tolist() == [10, 20, 30] and found.sum() == 60


def test_a_line_is_as_wide_across_as_asked() -> None:
    """On a slope pygame measures along an axis; without length a line keeps its width."""
    lines = np.array([[[0, 0], [9, 0]], [[0, 0], [9, 9]], [[0, 9], [9, 0]], [[4, 4], [4, 4]]])
    assert _widths(lines, np.array([10, 10, 10, 3])).tolist() == [10, 14, 14, 3]


# -- pictures of environments ---------------------------------------------------------------------


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("drawn", [0, 1, 12])
def test_a_copy_keeps_the_trails(copied: Callable[[Any], Any], drawn: int) -> None:
    """Its pictures are those of the original, whatever the original draws meanwhile."""
    env: Any = FormationEnv(render_mode="rgb_array", duration=0.5)
    env.reset(seed=0)
    for _ in range(drawn):
        env.step(np.full(8, 0.1, np.float32))
        env.render()
    twin = copied(copied(env))
    assert np.array_equal(env.render(), twin.render())
    for _ in range(25 - drawn):
        env.step(np.full(8, 0.1, np.float32))
        shown = env.render()
    for _ in range(25 - drawn):
        twin.step(np.full(8, 0.1, np.float32))
        again = twin.render()
    assert np.array_equal(shown, again)
    env.reset(seed=1), twin.reset(seed=1)
    assert np.array_equal(env.render(), twin.render())


def test_a_copy_that_has_not_drawn_forgets_the_trails_at_a_reset() -> None:
    env = FormationEnv(render_mode="rgb_array")
    env.reset(seed=0)
    for _ in range(10):
        env.step(np.full(8, 0.1, np.float32))
        env.render()
    twin, fresh = copy.deepcopy(env), FormationEnv(render_mode="rgb_array")
    twin.reset(seed=5), fresh.reset(seed=5)
    assert np.array_equal(twin.render(), fresh.render())


@pytest.mark.parametrize("duration", [0.02, 20.0, 200.0])
def test_all_of_a_path_is_drawn_where_it_is_short(duration: float) -> None:
    times = path_times(0.0, duration)
    assert times[0] == 0.0 and times[-1] < duration <= times[-1] + 0.1 + 1e-9
    np.testing.assert_array_equal(path_times(duration, duration), times)


@given(st.floats(0.0, 1e9), st.floats(200.1, 1e9))
def test_of_a_long_path_a_piece_around_now_is_drawn(clock: float, duration: float) -> None:
    clock = min(clock, duration)
    times = path_times(clock, duration)
    assert len(times) <= 2001 and (times <= duration).all() and times[0] >= 0.0
    assert times[0] <= clock
    assert times[-1] + 0.2 >= min(clock + 50.0, duration)


def test_an_endless_episode_is_drawn() -> None:
    env = FormationEnv(render_mode="rgb_array", duration=1e9)
    env.reset(seed=0)
    short = FormationEnv(render_mode="rgb_array", duration=200.0)
    short.reset(seed=0)
    assert np.array_equal(env.render(), short.render())
