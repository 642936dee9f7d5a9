# SPDX-License-Identifier: GPL-3.0-or-later
"""The programs of the live view, in Blender's own shader description, which serves OpenGL and Vulkan alike.

Positions are in voxels, as everywhere: voxel centres at integers. A texture's x is the grid's last axis, the one that
is contiguous in memory, so that an array is uploaded as it lies.
"""

from __future__ import annotations

import gpu
from gpu.types import GPUShader, GPUShaderCreateInfo, GPUStageInterfaceInfo

from ..core.bricks import BRICK
from .give import MOST, REACH

GROUP = (8, 8, 1)
"""Texels of a compute work group: cubes of 4 take half as long again where the processor does it."""
EASE = 3
"""Voxels along the edge of the means that a surface is shaded by: from smaller ones, voxels are seen as steps."""
FARTHEST = 26
"""Voxels to the farthest place that is asked how full it is, to shade a point."""
AROUND = FARTHEST + 1.5 * BRICK
"""Voxels beyond which what is around a point does not change how that looks: those bricks are not asked."""

FIELDS = (
    "start",  # of the line of sight in the middle of the picture,
    "start_x",  # and how that changes from there to the right edge
    "start_y",  # and to the upper edge
    "way",  # its direction,
    "way_x",  # and how that changes
    "way_y",
    "normal_x",  # rows of the matrix from slopes in voxels to slopes as the viewer sees them: to the right,
    "normal_y",  # up,
    "normal_z",  # and towards the viewer
    "clip_z",  # rows of the matrix from voxels to clip space that depth needs
    "clip_w",
    "shape",  # voxels along each axis; w: level
    "look",  # y: optical depth of a full voxel in fog; z: how many tools the surface gives under
)
"""What a march is told, four floats each, in the order of its uniform block; then, of each tool, ``give_tip`` (w: its
radius) and ``give_by``."""

_BLOCK = (
    "struct March {\n"
    + "".join(f"  vec4 {name};\n" for name in FIELDS)
    + f"  vec4 give_tip[{MOST}];\n  vec4 give_by[{MOST}];\n}};\n"
)

COVERING = [(-1.0, -1.0), (3.0, -1.0), (-1.0, 3.0)]
"""Corners of a triangle that covers the screen."""

_CORNERS = "void main() { ndc = corner; gl_Position = vec4(corner, 0.0, 1.0); }"

_CONSTANTS = f"""
#define BRICK {BRICK}.0
#define EASE {EASE}.0
#define GIVE_REACH {REACH}
#define FARTHEST {FARTHEST}.0
"""

_DENSITY = """
// How much of a reading counts that was clamped: outside the grid there is nothing, a voxel away from its border.
float fading(vec3 over)
{
  vec3 part = clamp(1.0 - abs(over), 0.0, 1.0);
  return part.x * part.y * part.z;
}

// Trilinear density.
float stored(vec3 v)
{
  vec3 place = clamp(v, vec3(0.0), march.shape.xyz - 1.0);
  float d = textureLod(density, ((place + 0.5) / march.shape.xyz).zyx, 0.0).r;
  return all(equal(place, v)) ? d : d * fading(v - place);
}

#ifdef GIVES
// What gives is seen elsewhere than it rests: give.py says by how much.
vec3 resting(vec3 v)
{
  vec3 rest = v;
  for (int k = 0; k < int(march.look.z); k++) {
    float radius = march.give_tip[k].w;
    vec3 off = v - march.give_tip[k].xyz, by = march.give_by[k].xyz;
    float far = length(off) / radius;
    if (far > GIVE_REACH) continue;
    float deep = length(by), axial = dot(off, by) / deep;
    float q = sqrt(max(dot(off, off) - axial * axial, 0.0) / (radius * deep));
    float share = q < 1.0 ? 1.0 - 0.5 * q * q : ((2.0 - q * q) * asin(1.0 / q) + sqrt(q * q - 1.0)) / 3.14159265;
    rest -= by * share * (1.0 - smoothstep(1.0, GIVE_REACH, far));
  }
  return rest;
}

// A slope of what rests, as it is seen at v.
vec3 seen(vec3 slope, vec3 v)
{
  const vec2 e = vec2(1.0, 0.0);
  return vec3(
    dot(slope, resting(v + e.xyy) - resting(v - e.xyy)),
    dot(slope, resting(v + e.yxy) - resting(v - e.yxy)),
    dot(slope, resting(v + e.yyx) - resting(v - e.yyx)));
}

bool may_give(vec3 v)
{
  for (int k = 0; k < int(march.look.z); k++)
    if (distance(v, march.give_tip[k].xyz) < GIVE_REACH * march.give_tip[k].w + 2.0 * BRICK) return true;
  return false;
}
#else
vec3 resting(vec3 v) { return v; }
vec3 seen(vec3 slope, vec3 v) { return slope; }
bool may_give(vec3 v) { return false; }
#endif

float at(vec3 v) { return stored(resting(v)); }

// A mean over bricks of some edge, between their middles.
float mean_at(sampler3D means, float edge, vec3 v)
{
  vec3 size = vec3(textureSize(means, 0).zyx);
  vec3 b = (v + 0.5) / edge - 0.5, place = clamp(b, vec3(0.0), size - 1.0);
  return textureLod(means, ((place + 0.5) / size).zyx, 0.0).r * fading(b - place);
}

// How full the room around v is, over about a brick.
float filled(vec3 v) { return mean_at(fillings, BRICK, v); }
"""

_DEPTH = """
float depth_of(vec3 v)
{
  return 0.5 * dot(march.clip_z, vec4(v, 1.0)) / dot(march.clip_w, vec4(v, 1.0)) + 0.5;
}
"""

_SHADING = """
// The slope of density as the eye takes it, without the voxels: that of a cubic B-spline over means of EASE voxels.
// Two readings between texels stand for four (Sigg and Hadwiger, GPU Gems 2, chapter 20).
vec3 slope(vec3 v)
{
  vec3 u = (v + 0.5) / EASE - 0.5, cell = floor(u), f = u - cell, r = 1.0 - f;
  vec3 upper = (1.0 + 3.0 * f + 3.0 * f * f - 2.0 * f * f * f) / 6.0, lower = 1.0 - upper;
  vec3 low = cell - r * r * r / (6.0 * lower), high = cell + 1.0 + f * f * f / (6.0 * upper);
  vec3 steep = 0.5 + f - f * f;  // of the derivative, half of whose weights are negative
  vec3 low_steep = cell - 0.5 * r * r / steep, high_steep = cell + 1.0 + 0.5 * f * f / steep;
#define READ(x, y, z) mean_at(eased, EASE, (vec3(x, y, z) + 0.5) * EASE - 0.5)
  vec3 sum = vec3(0.0);
  for (int k = 0; k < 4; k++) {
    bvec2 a = bvec2((k & 1) != 0, (k & 2) != 0);
    float wy = a.x ? upper.y : lower.y, wz = a.y ? upper.z : lower.z;
    float y = a.x ? high.y : low.y, z = a.y ? high.z : low.z;
    sum.x += wy * wz * (READ(high_steep.x, y, z) - READ(low_steep.x, y, z));
    float wx = a.x ? upper.x : lower.x, x = a.x ? high.x : low.x;
    sum.y += wx * wz * (READ(x, high_steep.y, z) - READ(x, low_steep.y, z));
    y = a.y ? high.y : low.y;
    sum.z += wx * (a.y ? upper.y : lower.y) * (READ(x, y, high_steep.z) - READ(x, y, low_steep.z));
  }
  return sum * steep / EASE;
}

// What `filled` finds this high above an even surface.
float even(float height) { return 0.5 * pow(clamp(1.0 - height / 12.0, 0.0, 1.0), 2.6); }

// How much of the light that comes this way to a point of the surface meets something else first.
float met_on_the_way(vec3 v, vec3 out_of, vec3 way, float full)
{
  float rise = max(dot(out_of, way), 0.0), met = 0.0;
  for (int k = 0; k < 3; k++) {
    float far = FARTHEST * (k == 0 ? 0.27 : k == 1 ? 0.54 : 0.9);
    float base = even(far * rise);
    met = max(met, (filled(v + way * far) / full - base) / (1.0 - base));
  }
  return clamp(met, 0.0, 1.0);
}

// How much of the sky is seen from a point of the surface: a dent is darker than its rim.
float open(vec3 v, vec3 out_of, float full)
{
  vec3 side = normalize(cross(out_of, abs(out_of.x) < 0.7 ? vec3(1, 0, 0) : vec3(0, 1, 0)));
  vec3 other = cross(out_of, side);
  float met = met_on_the_way(v, out_of, out_of, full);
  for (int k = 0; k < 5; k++) {
    float turn = float(k) * 1.2566371;
    met += met_on_the_way(v, out_of, 0.5 * out_of + 0.866 * (side * cos(turn) + other * sin(turn)), full);
  }
  return 1.0 - met / 6.0;
}

// Clay in a studio that turns with the viewer: a key from above left that grazes, a cool fill, a light from behind.
vec3 shade(vec3 v, vec3 way)
{
  const vec3 clay = vec3(0.47, 0.245, 0.16);
  const vec3 key = normalize(vec3(-0.60, 0.68, 0.44)), fill = normalize(vec3(0.75, 0.0, 0.65));
  const vec3 back = normalize(vec3(0.65, 0.30, -0.60));
  vec3 g = seen(slope(resting(v)), v);
  vec3 out_of = length(g) > 1e-5 ? -normalize(g) : -way;
  mat3 to_viewer = transpose(mat3(march.normal_x.xyz, march.normal_y.xyz, march.normal_z.xyz));
  vec3 n = normalize(to_viewer * out_of), to_key = normalize(key * to_viewer);

  float full = clamp(2.0 * march.shape.w, 0.05, 1.0), sky = open(v, out_of, full);
  float hollow = clamp((filled(v) / full - 0.5) * 0.9, -0.2, 0.3);  // a fold is darker, an edge lighter
  float lit = max(dot(n, key), 0.0) * (1.0 - 0.55 * met_on_the_way(v, out_of, to_key, full));
  vec3 light = mix(vec3(0.05, 0.045, 0.045), vec3(0.21, 0.22, 0.25), 0.5 + 0.5 * n.y) * sky * sky;
  light += vec3(1.42, 1.33, 1.20) * lit * mix(0.5, 1.0, sky);
  light += vec3(0.27, 0.31, 0.38) * max(dot(n, fill), 0.0) * sky;
  light += vec3(0.70, 0.74, 0.78) * max(dot(n, back), 0.0) * sky;
  float shine = 0.07 * pow(max(dot(n, normalize(key + vec3(0, 0, 1))), 0.0), 20.0) * lit;
  return clay * light * (1.0 - hollow) + shine;
}
"""

_SURFACE = """
#define STEP 0.5  // voxels: a sheet of one voxel is not missed
#define HALVINGS 6

float look_for() { return march.shape.w; }

bool look_at(vec3 v, float t, float least) { return at(v) >= least; }

void see(vec3 start, vec3 way, float former, float t, float least, bool met)
{
  if (!met) return;
  for (int h = 0; h < HALVINGS; h++) {
    float middle = 0.5 * (former + t);
    if (at(start + way * middle) >= least) t = middle; else former = middle;
  }
  colour = vec4(shade(start + way * t, way), 1.0);
  depth = depth_of(start + way * t);
}
"""

_FOG = """
#define STEP 1.0

float seen_at = 0.0;

float look_for() { return 0.002; }

// Light comes from above left, and gets so far as the fog lets it.
bool look_at(vec3 v, float t, float least)
{
  float alpha = 1.0 - exp(-at(v) * STEP * march.look.y);
  vec3 up = march.normal_y.xyz * 0.8 - march.normal_x.xyz * 0.5;
  float shadow = filled(v + up * 5.0) + filled(v + up * 14.0) + filled(v + up * 26.0);
  float part = (1.0 - colour.a) * alpha;
  colour += part * vec4(mix(vec3(0.022, 0.020, 0.022), vec3(0.72, 0.68, 0.62), exp(-1.1 * shadow)), 1.0);
  seen_at += part * t;
  return colour.a > 0.99;
}

// Fog is where most of it is seen.
void see(vec3 start, vec3 way, float former, float t, float least, bool met)
{
  if (colour.a < 0.004) colour = vec4(0.0);
  else depth = depth_of(start + way * seen_at / colour.a);
}
"""

_MARCH = """
#define MOST_BRICKS 2048

void main()
{
  colour = vec4(0.0);
  depth = 1.0;
  vec3 start = march.start.xyz + march.start_x.xyz * ndc.x + march.start_y.xyz * ndc.y;
  vec3 way = normalize(march.way.xyz + march.way_x.xyz * ndc.x + march.way_y.xyz * ndc.y);
  way += 1e-9 * vec3(lessThan(abs(way), vec3(1e-9)));
  vec3 per_way = 1.0 / way;
  // The part of the line that is in the grid, with the voxel around it in which density fades.
  vec3 a = (vec3(-1.0) - start) * per_way, b = (march.shape.xyz - start) * per_way;
  vec3 enter = min(a, b), leave = max(a, b);
  float t = max(max(max(enter.x, enter.y), enter.z), 0.0), end = min(min(leave.x, leave.y), leave.z);

  float least = look_for(), former = t;
  vec3 last = vec3(textureSize(bricks, 0).zyx) - 1.0, exit = 0.5 * BRICK + 0.5 * BRICK * sign(way);
  bool met = false;
  for (int k = 0; k < MOST_BRICKS && t < end && !met; k++) {
    vec3 v = start + way * t, brick = floor((v + 0.5) / BRICK);
    vec3 ends = (brick * BRICK - 0.5 + exit - start) * per_way;
    float brick_end = min(min(ends.x, ends.y), min(ends.z, end)) + 0.01;
    float most = texelFetch(bricks, ivec3(clamp(brick, vec3(0.0), last)).zyx, 0).r;
    if (most < least && !may_give(v)) {
      t = former = brick_end;
      continue;
    }
    while (t < brick_end) {
      met = look_at(start + way * t, t, least);
      if (met) break;
      former = t;
      t += STEP;
    }
  }
  see(start, way, former, t, least, met);
  if (depth >= 1.0) colour = vec4(0.0);  // beyond what the view shows
}
"""

_COMPOSITE = """
void main()
{
  ivec2 place = ivec2((ndc * 0.5 + 0.5) * vec2(textureSize(colours, 0)));
  vec4 seen = texelFetch(colours, place, 0);
  if (seen.a <= 0.0) discard;
  // An outline fades by how much beside it is not seen: its steps would flicker.
  ivec2 last = textureSize(colours, 0) - 1;
  float around = 0.0;
  for (int k = 0; k < 4; k++) {
    ivec2 beside = place + ivec2(k == 0 ? 1 : k == 1 ? -1 : 0, k == 2 ? 1 : k == 3 ? -1 : 0);
    around += texelFetch(colours, clamp(beside, ivec2(0), last), 0).a > 0.0 ? 0.25 : 0.0;
  }
  colour = seen * max(around, 0.25);
  gl_FragDepth = texelFetch(depths, place, 0).r;
}
"""

_PATCH = """
void main()
{
  ivec3 p = ivec3(gl_GlobalInvocationID);
  if (any(greaterThanEqual(p, size))) return;
  imageStore(kept, p + first, texelFetch(sent, p, 0));
}
"""


def _screen(name: str) -> GPUShaderCreateInfo:
    """A description of what covers the whole screen by one triangle."""
    info, between = GPUShaderCreateInfo(), GPUStageInterfaceInfo(name)
    between.smooth("VEC2", "ndc")
    info.vertex_in(0, "VEC2", "corner")
    info.vertex_out(between)
    info.vertex_source(_CORNERS)
    return info


def march_shader(fog: bool, gives: bool) -> GPUShader:
    """Lines of sight through the density: what each meets, its colour (premultiplied, linear) and its depth.

    As a surface or as fog; only with ``gives`` does it give under tools.
    """
    info = _screen("repousse_march")
    info.typedef_source(_BLOCK)
    info.uniform_buf(0, "March", "march")
    info.sampler(0, "FLOAT_3D", "density")
    info.sampler(1, "FLOAT_3D", "bricks")
    info.sampler(2, "FLOAT_3D", "eased")
    info.sampler(3, "FLOAT_3D", "fillings")
    info.fragment_out(0, "VEC4", "colour")
    info.fragment_out(1, "FLOAT", "depth")
    constants = _CONSTANTS + "#define GIVES\n" * gives
    info.fragment_source(constants + _DENSITY + _DEPTH + (_FOG if fog else _SHADING + _SURFACE) + _MARCH)
    return gpu.shader.create_from_info(info)


def composite_shader() -> GPUShader:
    """A marched picture into the scene, by its depth."""
    info = _screen("repousse_composite")
    info.sampler(0, "FLOAT_2D", "colours")
    info.sampler(1, "FLOAT_2D", "depths")
    info.fragment_out(0, "VEC4", "colour")
    info.depth_write("ANY")
    info.fragment_source(_COMPOSITE)
    return gpu.shader.create_from_info(info)


def patch_shader(texture_format: str) -> GPUShader:
    """A small texture into a large one of a format, at an offset."""
    info = GPUShaderCreateInfo()
    info.local_group_size(*GROUP)
    info.sampler(0, "FLOAT_3D", "sent")
    info.image(0, texture_format, "FLOAT_3D", "kept", qualifiers={"WRITE"})
    info.push_constant("IVEC3", "first")
    info.push_constant("IVEC3", "size")
    info.compute_source(_PATCH)
    return gpu.shader.create_from_info(info)
