# SPDX-License-Identifier: GPL-3.0-or-later
"""The programs of the live view, in Blender's own shader description, which serves OpenGL and Vulkan alike.

Positions are in voxels, as everywhere: voxel centres at integers. A texture's x is the grid's last axis, the one that
is contiguous in memory, so that an array is uploaded as it lies.
"""

from __future__ import annotations

import gpu
from gpu.types import GPUShader, GPUShaderCreateInfo, GPUStageInterfaceInfo

GROUP = 4
"""Edge of a compute work group, in voxels."""

MARCH_FIELDS = (
    "eye",  # xyz: where lines of sight begin, when w is 1; the same for all when w is 0: their direction
    "plane",  # a plane that all lines of sight cross: its middle,
    "across",  # and how far it goes to the right
    "up",  # and up, from the middle to the edge of the picture
    "shape",  # voxels along each axis; w: level
    "to_view_x",  # rows of the rotation from voxel axes to the viewer's: right,
    "to_view_y",  # up,
    "to_view_z",  # and towards the viewer
    "give",  # voxels by which the surface gives under the tool
    "give_at",  # where; w: over how many voxels it fades
    "look",  # x: 1 for fog; y: opacity of a full voxel in fog
    "clip_z",  # rows of the matrix from voxels to clip space that depth needs
    "clip_w",
)
"""What a march is told, four floats each, in the order of its uniform block."""

_BLOCK = "struct March {\n" + "".join(f"  vec4 {name};\n" for name in MARCH_FIELDS) + "};\n"

COVERING = [(-1.0, -1.0), (3.0, -1.0), (-1.0, 3.0)]
"""Corners of a triangle that covers the screen."""

_CORNERS = "void main() { ndc = corner; gl_Position = vec4(corner, 0.0, 1.0); }"

_DENSITY = """
// Trilinear density, 0 outside the grid: what is clamped is read, and fades over the voxel beyond the border.
float stored(vec3 v)
{
  vec3 n = march.shape.xyz;
  vec3 ramp = clamp(v + 1.0, 0.0, 1.0) * clamp(n - v, 0.0, 1.0);
  vec3 place = clamp(v, vec3(0.0), n - 1.0);
  return textureLod(density, ((place + 0.5) / n).zyx, 0.0).r * ramp.x * ramp.y * ramp.z;
}

// What is loaded elastically gives: what is seen at v is the material that rests a little behind it.
vec3 resting(vec3 v)
{
  if (march.give.w < 0.5) return v;
  vec3 away = (v - march.give_at.xyz) / march.give_at.w;
  return v - march.give.xyz * exp(-0.5 * dot(away, away));
}

float at(vec3 v) { return stored(resting(v)); }
"""

_MARCH = """
#define LONGEST 4096      // steps of a line of sight
#define STEP 0.75         // voxels: a sheet of one voxel is two wide where it can be seen
#define FOG_STEP 1.0
#define BRICK 8.0
#define HALVINGS 6
#define NEAR_GIVE 4.0     // widths from the tool beyond which nothing gives

vec3 seen_at(vec2 from_middle)
{
  return march.plane.xyz + march.across.xyz * from_middle.x + march.up.xyz * from_middle.y;
}

vec3 along(vec2 from_middle)
{
  return march.eye.w > 0.5 ? normalize(seen_at(from_middle) - march.eye.xyz) : march.eye.xyz;
}

vec3 begin_of(vec2 from_middle)
{
  return march.eye.w > 0.5 ? march.eye.xyz : seen_at(from_middle);
}

// The part of a line of sight that is in a box; nothing when y < x.
vec2 inside(vec3 start, vec3 way, vec3 low, vec3 high)
{
  vec3 safe = mix(way, vec3(1e-9), lessThan(abs(way), vec3(1e-9)));
  vec3 a = (low - start) / safe, b = (high - start) / safe;
  vec3 enter = min(a, b), leave = max(a, b);
  return vec2(max(max(enter.x, enter.y), enter.z), min(min(leave.x, leave.y), leave.z));
}

// Where the brick ends that holds v: bricks without anything to see are passed in one step.
float brick_end(vec3 v, vec3 way)
{
  vec3 corner = floor((v + 0.5) / BRICK) * BRICK - 0.5;
  return inside(v, way, corner, corner + BRICK).y;
}

bool nothing_in_brick(vec3 v)
{
  if (march.give.w > 0.5 && distance(v, march.give_at.xyz) < NEAR_GIVE * march.give_at.w + BRICK) return false;
  ivec3 brick = clamp(ivec3(floor((v + 0.5) / BRICK)), ivec3(0), textureSize(bricks, 0).zyx - 1);
  return texelFetch(bricks, brick.zyx, 0).r < (march.look.x > 0.5 ? 1e-3 : march.shape.w);
}

// The slope of density around v. Density is level on both sides of a surface, so each pair of points says little more
// than on which side they are: it takes many, evenly around, or every voxel shows as a step.
vec3 slope(vec3 v)
{
  const vec2 e = vec2(1.06, -1.06), f = vec2(2.5, 0.0);
  const float c = 1.155;
  vec3 way[13] = vec3[13](
    vec3(e.xx, 0.0), vec3(e.xy, 0.0), vec3(e.x, 0.0, e.x), vec3(e.x, 0.0, e.y), vec3(0.0, e.xx), vec3(0.0, e.xy),
    vec3(c, c, c), vec3(c, -c, -c), vec3(-c, c, -c), vec3(-c, -c, c), f.xyy, f.yxy, f.yyx
  );
  vec3 sum = vec3(0.0);
  for (int k = 0; k < 13; k++) {
    float weight = k < 6 ? 1.0 / 1.5 : k < 10 ? 1.0 / 2.0 : 1.0 / 2.5;
    sum += weight * way[k] * (at(v + way[k]) - at(v - way[k]));
  }
  return sum;
}

// How much of the sky over a point of the surface is hidden: a dent is darker than its rim. Rings are turned against
// each other, so that the outline of what hides it is not seen again and again.
float hidden(vec3 v, vec3 out_of)
{
  vec3 side = normalize(abs(out_of.x) < 0.8 ? cross(out_of, vec3(1, 0, 0)) : cross(out_of, vec3(0, 1, 0)));
  vec3 other = cross(out_of, side);
  float sum = 0.0, weights = 0.0, far = 5.0;
  for (int ring = 0; ring < 3; ring++) {
    float weight = 1.0 / (1.0 + 0.03 * far);
    for (int k = 0; k < 7; k++) {
      float turn = (float(k) + float(ring) / 3.0) * 0.8975979;
      vec3 way = normalize(out_of * 0.6 + side * cos(turn) + other * sin(turn));
      sum += weight * smoothstep(0.1, 1.5, at(v + way * far) / max(march.shape.w, 1e-3));
    }
    weights += 7.0 * weight;
    far *= 1.8;
  }
  return min(1.5 * sum / weights, 1.0);
}

float towards(vec3 n, vec3 light) { return max(dot(n, normalize(light)), 0.0); }

// As if lit in a studio that turns with the viewer: a key from above left, a fill, an edge light.
vec3 shade(vec3 v, vec3 way)
{
  vec3 g = slope(v);
  vec3 out_of = length(g) > 1e-6 ? -normalize(g) : -way;
  vec3 n = vec3(dot(march.to_view_x.xyz, out_of), dot(march.to_view_y.xyz, out_of), dot(march.to_view_z.xyz, out_of));
  const vec3 clay = vec3(0.47, 0.29, 0.20);
  const vec3 key = vec3(-0.60, 0.70, 0.40), fill = vec3(0.9, 0.0, 0.35), edge = vec3(0.3, -0.7, -0.25);
  vec3 sky = mix(vec3(0.035, 0.030, 0.030), vec3(0.13, 0.14, 0.165), 0.5 + 0.5 * n.y);
  float open = 1.0 - hidden(v, out_of);
  open *= open;
  vec3 light = sky * mix(0.2, 1.0, open);
  light += vec3(1.25, 1.17, 1.05) * towards(n, key) * mix(0.3, 1.0, open);
  light += vec3(0.14, 0.18, 0.25) * towards(n, fill) * mix(0.4, 1.0, open);
  light += vec3(0.25, 0.22, 0.20) * pow(1.0 - max(n.z, 0.0), 3.0) * towards(n, edge);
  vec3 half_way = normalize(normalize(key) + vec3(0, 0, 1));
  float shine = 0.09 * pow(max(dot(n, half_way), 0.0), 22.0) * open;
  return clay * light + shine;
}

float depth_of(vec3 v)
{
  float z = dot(march.clip_z, vec4(v, 1.0)), w = dot(march.clip_w, vec4(v, 1.0));
  return clamp(0.5 * z / w + 0.5, 0.0, 1.0);
}

void main()
{
  colour = vec4(0.0);
  depth = 1.0;
  vec3 way = along(ndc), start = begin_of(ndc);
  vec2 part = inside(start, way, vec3(-1.0), march.shape.xyz);
  if (march.eye.w > 0.5) part.x = max(part.x, 0.0);
  bool fog = march.look.x > 0.5, met = false;
  float t = part.x + 1e-3, former = t, first = -1.0;
  for (int k = 0; k < LONGEST && t < part.y; k++) {
    vec3 v = start + way * t;
    if (nothing_in_brick(v)) {
      former = t;
      t += max(brick_end(v, way), 0.0) + 0.01;
      continue;
    }
    float d = at(v);
    if (fog) {
      float alpha = 1.0 - exp(-d * FOG_STEP * march.look.y);
      if (first < 0.0 && alpha > 1e-3) first = t;
      float lit = exp(-0.35 * (at(v + march.to_view_y.xyz * 3.0) + at(v + march.to_view_y.xyz * 7.0)));
      colour += (1.0 - colour.a) * vec4(vec3(0.62, 0.60, 0.58) * mix(0.25, 1.0, lit) * alpha, alpha);
      if (colour.a > 0.99) break;
    }
    met = !fog && d >= march.shape.w;
    if (met) break;
    former = t;
    t += fog ? FOG_STEP : STEP;
  }
  if (fog) {
    if (first >= 0.0) depth = depth_of(start + way * first);
    return;
  }
  if (!met) return;
  for (int h = 0; h < HALVINGS; h++) {
    float middle = 0.5 * (former + t);
    if (at(start + way * middle) >= march.shape.w) t = middle; else former = middle;
  }
  colour = vec4(shade(start + way * t, way), 1.0);
  depth = depth_of(start + way * t);
}
"""

_COMPOSITE = """
void main()
{
  ivec2 place = ivec2((ndc * 0.5 + 0.5) * vec2(textureSize(colours, 0)));
  vec4 seen = texelFetch(colours, place, 0);
  if (seen.a <= 0.0) discard;
  // A silhouette fades by what is not seen on either side of it, or its steps would flicker.
  ivec2 last = textureSize(colours, 0) - 1;
  float around = 0.0;
  for (int k = 0; k < 4; k++) {
    ivec2 next = place + ivec2(k == 0 ? 1 : k == 1 ? -1 : 0, k == 2 ? 1 : k == 3 ? -1 : 0);
    around += texelFetch(colours, clamp(next, ivec2(0), last), 0).a > 0.0 ? 0.25 : 0.0;
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
  imageStore(density, p + first, vec4(texelFetch(patch_, p, 0).r));
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


def march_shader() -> GPUShader:
    """Lines of sight through the density: colour (premultiplied, linear) and depth of what each meets."""
    info = _screen("repousse_march")
    info.typedef_source(_BLOCK)
    info.uniform_buf(0, "March", "march")
    info.sampler(0, "FLOAT_3D", "density")
    info.sampler(1, "FLOAT_3D", "bricks")
    info.fragment_out(0, "VEC4", "colour")
    info.fragment_out(1, "FLOAT", "depth")
    info.fragment_source(_DENSITY + _MARCH)
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
    """A small texture into a large one, at an offset."""
    info = GPUShaderCreateInfo()
    info.local_group_size(GROUP, GROUP, GROUP)
    info.sampler(0, "FLOAT_3D", "patch_")
    info.image(0, texture_format, "FLOAT_3D", "density", qualifiers={"WRITE"})
    info.push_constant("IVEC3", "first")
    info.push_constant("IVEC3", "size")
    info.compute_source(_PATCH)
    return gpu.shader.create_from_info(info)
