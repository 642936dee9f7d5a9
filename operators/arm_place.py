# SPDX-License-Identifier: GPL-3.0-or-later
"""What an arm's force depends on besides its own strokes: how it lies over which voxels, what tool, what material.

Two looks that find the same Place find the same scene.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import bpy
import numpy as np

from ..core import Material, SphereTool
from ..core.tool import DEFAULT_REACH, Vector, vector
from .aim import Aim, bounded_radius, size_of, voxels_to_world
from .arm_mapping import ArmMapping, Workspace

if TYPE_CHECKING:
    from ..device import DeviceProfile
    from .arm_session import ArmSettings
    from .session import Session
    from .settings import RepousseSettings


class View(NamedTuple):
    """A 3D view on the volume that is sculpted. Blender's own things: not to be kept from one look to the next."""

    window: bpy.types.Window
    area: bpy.types.Area
    region: bpy.types.Region
    eye: bpy.types.RegionView3D
    obj: bpy.types.Object


def view_of(context: bpy.types.Context, session: Session) -> View | None:
    """The largest 3D view of the first window in which the session's volume is the active object."""
    for window in context.window_manager.windows:
        obj = window.view_layer.objects.active
        if obj is None or obj.type != "VOLUME" or obj.data.session_uid != session.volume_uid:
            continue
        areas = [area for area in window.screen.areas if area.type == "VIEW_3D"]
        if areas:
            area = max(areas, key=lambda area: area.width * area.height)
            region = next(region for region in area.regions if region.type == "WINDOW")
            return View(window, area, region, area.spaces.active.region_3d, obj)
    return None


@dataclass(frozen=True)
class Place:
    """How the arm lies over a volume, and what it pushes with into what.

    Parameters
    ----------
    laid
        What ``workspace`` was made from: as long as that stays, so does the workspace, even where the volume grows and
        shrinks.
    workspace
        Where the arm's workspace lies in the world.
    shift
        (3,) m, what the clutch has taken the hand back.
    radius
        Of the tool, in world units.
    material
        What the volume is made of.
    generation
        The session's: which voxels.
    """

    laid: tuple
    workspace: Workspace
    shift: Vector
    radius: float
    material: Material
    generation: int

    def mapping(self, profile: DeviceProfile, to_world: np.ndarray) -> ArmMapping:
        """The way to voxels that ``to_world`` (4, 4) places. Raises ValueError where there is none."""
        from_device = self.workspace.from_device(profile.workspace_centre, self.shift)
        try:
            return ArmMapping(np.linalg.inv(to_world) @ from_device)
        except np.linalg.LinAlgError as error:
            raise ValueError("the arm cannot be laid over this volume: it is flat") from error

    def radius_in(self, to_world: np.ndarray) -> float:
        """The tool's radius in voxels that ``to_world`` (4, 4) places, within what can be solved in real time."""
        return bounded_radius(self.radius / size_of(to_world))

    def tool_in(self, to_world: np.ndarray) -> SphereTool:
        """The tool, in such voxels."""
        radius = self.radius_in(to_world)
        return SphereTool(radius, DEFAULT_REACH * radius)


def place_of(
    view: View,
    session: Session,
    settings: RepousseSettings,
    wanted: ArmSettings,
    profile: DeviceProfile,
    shift: Vector,
    former: Place | None,
) -> Place:
    """The Place as things are now; ``former`` is the one that was found before.

    Raises ValueError with one line where the workspace has none.
    """
    matrix = np.array(view.obj.matrix_world, np.float64)
    laid = (session.volume_uid, wanted.axes, wanted.workspace_scale, _numbers(matrix), *_seen_from(view, wanted.axes))
    if former is not None and former.laid == laid:
        workspace = former.workspace
    else:
        workspace = _workspace(view, session, wanted, profile.workspace_radius)
    aim = Aim.of(view.region, view.eye, np.eye(4))
    radius = aim.length(workspace.centre, settings.radius)
    return Place(laid, workspace, shift, radius, settings.clay, session.generation)


def _workspace(view: View, session: Session, wanted: ArmSettings, reach: float) -> Workspace:
    """The arm's ``reach`` (m) over half the smaller side of the view, or half the largest edge of the object."""
    to_world = voxels_to_world(view.obj, session)
    low, high = np.full(3, -0.5), np.array(session.grid.shape) - 0.5
    middle = vector((to_world @ (*(low + high) / 2.0, 1.0))[:3])
    if wanted.axes == "OBJECT":
        matrix = np.array(view.obj.matrix_world, np.float64)
        span = wanted.workspace_scale * float((np.linalg.norm(to_world[:3, :3], axis=0) * (high - low)).max()) / 2.0
        return Workspace.on_object(matrix, middle, span, reach)
    # What the view turns about is in its middle; a camera has no such thing.
    centre = middle if view.eye.view_perspective == "CAMERA" else vector(view.eye.view_location)
    aim = Aim.of(view.region, view.eye, np.eye(4))
    span = aim.length(centre, min(view.region.width, view.region.height) / 2.0)
    to_world = np.linalg.inv(np.array(view.eye.view_matrix, np.float64))
    return Workspace.in_view(to_world, centre, wanted.workspace_scale * span, reach)


def _seen_from(view: View, axes: str) -> tuple:
    """What of a view a workspace depends on."""
    if axes == "OBJECT":
        return ()
    eye = view.eye
    return (
        _numbers(np.array(eye.perspective_matrix)),
        tuple(eye.view_location),
        eye.view_perspective,
        view.region.width,
        view.region.height,
    )


def _numbers(matrix: np.ndarray) -> tuple[float, ...]:
    return tuple(matrix.ravel().tolist())
