// SPDX-License-Identifier: GPL-3.0-or-later
//
// The material's kernels (DESIGN 3): estimate, empty, loosen, sweep, put_back, rim, smooth. Each has a numpy twin beside its caller in
// core/, which does the same operations in the same order and type; tests hold the two together. The callers own all
// memory; nothing here allocates.
//
// Index space: voxel centres at integers, lengths in voxels, density float32 in [0, 1], axis 2 contiguous.

#if defined(__x86_64__)
#include <cpuid.h>
#endif
#include <math.h>
#include <stdint.h>
#include <string.h>

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

#define ALWAYS_INLINE static inline __attribute__((always_inline)) // 6 % of a push, where it is used twice

#define ABI_VERSION 3          // the loader refuses any other
#define BRICK 8                // edge of a brick, core/bricks.py
#define SHELL 0.5              // thickness of the shells that are emptied one after another, voxels
#define MAX_SHELLS 4096        // so tools are under 2000 voxels thick
#define NEGLIGIBLE 1e-4f       // flux below this at the window's edge is folded inward (DESIGN 2)
#define CACHE_LINE 16          // float32 values in a line
#define SLAB_PLANES CACHE_LINE // planes along axis 2 that share a line
#define ROWS_AHEAD 8           // rows whose memory is asked for before they are read
#define SLAB_MARGIN 4          // room for the window to grow in before a slab is read again
#define NEARLY_FULL 1e-3f      // a voxel with less room than this is full, for the rim (facts/rim.md)
#define LITTLE_ROOM 0.02       // below this room a voxel's weight fades, so that rounding cannot switch it on and off
#define PLACINGS 3             // rounds in which the surplus is laid on one list of voxels
#define ENOUGH 1e-3            // share of it that may be left over without another round
#define NEAR 2.6               // voxels from the tool within which the voxel behind a neighbour may be cut by it
#define RISING 0.4f            // density from which a voxel begins to carry another one on it,
#define RISEN 0.6f             // and that at which it does so wholly (core/rim.py)
#define LATTICE 40             // most nodes along an axis of the lattice on which the hats are summed
#define NODES_IN_HAT 6.0       // its nodes within the radius of a hat
#define FAINT 0.01             // share of all that was emptied below which a sum of hats counts as none
#define SIGHT_CELL 3.0         // edge in voxels of the cells of surface that share a line of material
#define SIGHT_INSET 1.51 // voxels below the surface at which the line of material begins; not 1.5: that rounds by side
#define SIGHT_STEP 1.5   // voxels between samples of that line, or more, for at most
#define SIGHT_SAMPLES 16.0 // so many of them
#define SIGHT_AIR 0.25f    // density below this is air on that line
#define CLUSTERS 9         // clusters of emptied material along each axis
#define MAX_POINTS (CLUSTERS * CLUSTERS * CLUSTERS)
#define CLUSTERS_IN_RADIUS 2.5
#define LEAST_GIVEN 1e-5 // density above its level below which a voxel gives nothing to a pull: it is rounding
#define STRETCH 32       // voxels of a row that are looked at together for a surface
#define LANES 8          // running sums that the compiler may turn into vectors

#define FRAME 2 // zeros around the flux

enum Border { GROW = 0, WALL = 1, OPEN = 2 };
enum State { EMPTY = 0, FULL = 1, MIXED = 2 }; // of a brick
enum Status { DONE = 0, NEEDS_GROWTH = 1, LIST_FULL = 2 };

typedef struct {
    double half_size[3], half_axis[3], radius;
    int64_t ball; // neither half_size nor half_axis: most tools are, and they have faster ways
} Shape;

typedef struct {
    Shape volume, surroundings; // the tool t; the tool and its reach s
    double centre[3];
} Tool;

typedef struct {
    float *density;
    int64_t shape[3];
    uint8_t *states; // of bricks (core/bricks.py); NULL where nobody knows
    // Before-images of bricks (core/history.py); kept is NULL when nobody asked for them.
    uint8_t *kept;
    float *images;
    int64_t *bricks, *entries, *kept_count, *image_count; // entry: the image's number from 1, or -1 - State
} Grid;

typedef struct {
    double tool_mass, reach_mass, gradient[3];
    int64_t read; // voxels
} Estimate;

typedef struct {
    int64_t index, shell; // flat, in the grid; counted inward from the tool's skin
    double covered;       // w
} Occupied;

typedef struct {
    int64_t axis;              // dominant axis of the push: the buffer is ordered (axis, the other two in order)
    float *buffer;             // mass taken from each voxel of the box
    int64_t low[3], n[3];      // the box around the tool, in (a, b, c) order
    int64_t first[3], last[3]; // the part of it that is not zero, half open, as grid indices in (a, b, c) order
    double mass, tool_loss, reach_loss;
    Occupied *occupied; // scratch, a place for each voxel of the box
    double carry;       // what rounding to float32 has kept back so far; it travels with the next flux
} Emptied;

typedef struct {
    double direction[3]; // unit vector u, grid order
    double limit;        // distance ahead of the tool's centre along u beyond which nothing goes (the band)
    float weights[9];    // 3x3 spreading kernel, (b, c) order
    int64_t shift[2];    // whole-voxel part of the shear
    int64_t border;
    // Leaps: `hole` voxels lie between the taps of their kernel, so one spreads for hole^2 planes; 0 is no leap.
    int64_t hole, leap_shift[2];
    float leap_weights[9];
    double far; // planes ahead of the tool's centre from which on the flux may leap
    float *flux, *next, *row, *slab;
    int64_t window[4];         // b0, b1, c0, c1 of the active window, half open
    int64_t origin[2], stride; // where the flux buffer starts and its row length
    int64_t plane, spread_done;
    int64_t needs[6]; // the sides that must grow: below and above along axes 0, 1, 2
    double laid, reach_gain, mass_out, surplus;
    int64_t planes, visited, read; // visited: cells of flux; read: voxels of density
    int64_t dirty[6];              // low and high of what was written, grid order
} Sweep;

typedef struct {
    double x[MAX_POINTS], y[MAX_POINTS], z[MAX_POINTS], mass[MAX_POINTS]; // mean position and mass of each cluster
    int64_t count;
    double contact_radius;
} Sources;

typedef struct { // of the surface: sums over the voxels in it that can take material
    double at[3], inward[3];
    int64_t count, joined; // joined: 0 not known yet, else APART or JOINED
} Cell;

enum { APART = 1, JOINED = 2 };

typedef struct {
    int64_t *index; // place (see `place_of`) of each voxel that can take material
    float *weight;
    int64_t *spill_index; // those that were given more than they hold, and how much more
    float *spill;
    int64_t capacity, count, spilling;
    const float *zeros; // a row of air, for what lies outside the grid
    float *lattice;     // scratch, LATTICE nodes along each axis
    Cell *cells;        // scratch, the cells of one layer across axis 0; all zero between calls
    double direction[3], wake;
    double tool_gain, reach_gain; // of M_t and M_s, by what was laid
    int64_t dirty[6];
    int64_t hats, asked, sights; // counted since ever: hats evaluated, voxels asked for a weight, samples of lines
} Rim;

// Whether processor and system have AVX2: then the loader takes the library that was compiled for it from this source.
EXPORT int64_t repousse_has_avx2(void) {
#if defined(__x86_64__)
    unsigned a, b, c, d, low, high;
    if (!__get_cpuid(1, &a, &b, &c, &d) || !(c & bit_OSXSAVE) || !(c & bit_AVX)) return 0;
    __asm__("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    if ((low & 6) != 6) return 0; // the system saves the registers
    return __get_cpuid_count(7, 0, &a, &b, &c, &d) && (b & bit_AVX2) != 0;
#else
    return 0;
#endif
}

static int64_t least(int64_t a, int64_t b) { return a < b ? a : b; }
static int64_t most(int64_t a, int64_t b) { return a > b ? a : b; }
static int64_t within(int64_t x, int64_t low, int64_t high) { return most(low, least(x, high)); }

static int64_t floor_of(double x) {
    const int64_t whole = (int64_t)x;
    return whole - (x < (double)whole);
}

static int64_t ceil_of(double x) { return -floor_of(-x); }

// Shapes: signed distance, coverage, and the rows of voxels that a shape covers.

static double clamp(double x, double low, double high) { return x < low ? low : x > high ? high : x; }

// Signed distance of a point relative to the shape's centre; the same arithmetic as Shape.distance in core/tool.py.
static double distance(const Shape *s, double x, double y, double z) {
    if (s->ball) return sqrt(x * x + y * y + z * z) - s->radius;
    const double ax = s->half_axis[0], ay = s->half_axis[1], az = s->half_axis[2];
    const double length2 = ax * ax + ay * ay + az * az;
    if (length2 > 0.0) {
        const double along = clamp((x * ax + y * ay + z * az) / length2, -1.0, 1.0);
        x -= along * ax;
        y -= along * ay;
        z -= along * az;
    }
    double inside = 0.0;
    if (s->half_size[0] > 0.0) {
        x = fabs(x) - s->half_size[0];
        y = fabs(y) - s->half_size[1];
        z = fabs(z) - s->half_size[2];
        inside = fmin(fmax(fmax(x, y), z), 0.0);
        x = fmax(x, 0.0);
        y = fmax(y, 0.0);
        z = fmax(z, 0.0);
    }
    return sqrt(x * x + y * y + z * z) + inside - s->radius;
}

static double coverage_at(double distance_) { return clamp(0.5 - distance_, 0.0, 1.0); }

static double coverage(const Shape *s, double x, double y, double z) { return coverage_at(distance(s, x, y, z)); }

// Outward unit normal of the shape's surface nearest to a point: the gradient of its distance.
static void normal(const Shape *s, double x, double y, double z, double n[3]) {
    double v[3] = {x, y, z};
    const double *a = s->half_axis, *h = s->half_size;
    const double length2 = a[0] * a[0] + a[1] * a[1] + a[2] * a[2];
    if (length2 > 0.0) {
        const double along = clamp((x * a[0] + y * a[1] + z * a[2]) / length2, -1.0, 1.0);
        for (int i = 0; i < 3; i++) v[i] -= along * a[i];
    }
    if (h[0] > 0.0) {
        double q[3], deepest = -INFINITY;
        for (int i = 0; i < 3; i++) {
            q[i] = fabs(v[i]) - h[i];
            deepest = fmax(deepest, q[i]);
        }
        // Inside, the nearest face, or equally all that are equally near.
        for (int i = 0; i < 3; i++) {
            const double part = deepest > 0.0 ? fmax(q[i], 0.0) : (q[i] == deepest ? 1.0 : 0.0);
            v[i] = v[i] < 0.0 ? -part : part;
        }
    }
    const double length = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    for (int i = 0; i < 3; i++) n[i] = length > 0.0 ? v[i] / length : 0.0;
}

static double extent(const Shape *s, int axis) { return s->half_size[axis] + fabs(s->half_axis[axis]) + s->radius; }

typedef struct {
    int64_t low, high; // voxels of a row with coverage > 0, half open
} Span;

static const Span no_span = {0, 0};

// A ball needs no root for each voxel of its row: |p| < R + 1/2 is asked of squares.
static Span ball_span(double radius, double across2, double z, int64_t n) {
    const double outer2 = (radius + 0.5) * (radius + 0.5);
    if (across2 >= outer2) return no_span;
    const double half = sqrt(outer2 - across2);
    int64_t low = ceil_of(z - half), high = floor_of(z + half); // right but for rounding, which these two lines mend
    low += across2 + ((double)low - z) * ((double)low - z) >= outer2;
    high += across2 + ((double)high - z) * ((double)high - z) < outer2;
    low = most(low, 0);
    return (Span){low, most(low, least(high, n))};
}

// The voxels of one row that a convex shape covers: x, y are the row's offsets from the centre, z the centre's index.
static Span row_span(const Shape *s, double x, double y, double z, int64_t n) {
    if (s->ball) return ball_span(s->radius, x * x + y * y, z, n);
    if (fabs(x) >= extent(s, 0) + 0.5 || fabs(y) >= extent(s, 1) + 0.5) return no_span;
    const double half = extent(s, 2) + 0.5;
    Span span = {most(0, ceil_of(z - half) - 1), least(n, floor_of(z + half) + 2)};
    while (span.low < span.high && distance(s, x, y, (double)span.low - z) >= 0.5) span.low++;
    while (span.low < span.high && distance(s, x, y, (double)(span.high - 1) - z) >= 0.5) span.high--;
    return span;
}

// Sums run in LANES parts, which lets the compiler use vectors without reordering additions.
static double lane_sum(const double lanes[LANES]) {
    return ((lanes[0] + lanes[1]) + (lanes[2] + lanes[3])) + ((lanes[4] + lanes[5]) + (lanes[6] + lanes[7]));
}

static uint32_t any_bits(const float *v, int64_t n) { // of numbers >= 0: not zero when any of them is not
    uint32_t bits = 0;
    for (int64_t k = 0; k < n; k++) {
        uint32_t word;
        memcpy(&word, v + k, sizeof word);
        bits |= word;
    }
    return bits;
}

// What the map knows of the rows that go through the same bricks (core/bricks.py), half open.
typedef struct {
    int64_t some, some_end; // elsewhere all is 0
    int64_t full, full_end; // here all is 1
} Known;

static const Known nothing_known = {0, INT64_MAX, 0, 0};

static Known known_of(const Grid *g, int64_t i, int64_t j, int64_t low, int64_t high) {
    if (!g->states || low >= high) return nothing_known;
    const int64_t nj = (g->shape[1] + BRICK - 1) / BRICK, nk = (g->shape[2] + BRICK - 1) / BRICK;
    const uint8_t *states = g->states + (i / BRICK * nj + j / BRICK) * nk;
    Known known = {INT64_MAX, 0, high, 0};
    int64_t k = low / BRICK, end = (high + BRICK - 1) / BRICK;
    while (k < end && states[k] == EMPTY) k++;
    while (k < end && states[end - 1] == EMPTY) end--;
    if (k == end) return known;
    known.some = k * BRICK;
    known.some_end = end * BRICK;
    while (k < end && states[k] != FULL) k++;
    known.full = k * BRICK;
    while (k < end && states[k] == FULL) k++;
    known.full_end = k * BRICK;
    return known;
}

static int is_empty(const Known *known, int64_t low, int64_t high) {
    return high <= known->some || low >= known->some_end;
}

static int is_full(const Known *known, int64_t low, int64_t high) {
    return low >= known->full && high <= known->full_end;
}

// Whether any of the voxels [low, high) of a row is not 0.
static int any_in(const Known *known, const float *d, int64_t low, int64_t high, int64_t *read) {
    if (is_full(known, low, high)) return 1;
    low = most(low, known->some);
    high = least(high, known->some_end);
    *read += most(0, high - low);
    return any_bits(d + low, high - low) != 0;
}

static double row_sum(const float *v, int64_t n) {
    double lanes[LANES] = {0.0};
    int64_t k = 0;
    for (; k + LANES <= n; k += LANES)
        for (int l = 0; l < LANES; l++) lanes[l] += (double)v[k + l];
    for (; k < n; k++) lanes[0] += (double)v[k];
    return lane_sum(lanes);
}

static int64_t whole_lanes(int64_t n) { return (n + LANES - 1) / LANES * LANES; }

// A ball's share of LANES voxels of a row, times their values: `across2` is the row's squared distance from its centre,
// `z` the offset of the first voxel. Without a branch, for a row's ends are not to be predicted; and in float32, for
// the root's error of 2e-6 voxel averages out over the thousands of voxels of the skin.
ALWAYS_INLINE void add_covered(float radius, float across2, float z, const float *restrict v, float *restrict lanes) {
    for (int l = 0; l < LANES; l++) {
        const float at = z + (float)l, inside = 0.5f - (sqrtf(across2 + at * at) - radius);
        const float some = inside > 0.0f ? inside : 0.0f;
        lanes[l] += (some < 1.0f ? some : 1.0f) * v[l];
    }
}

static const float ones[LANES] = {1.0f, 1.0f, 1.0f, 1.0f, 1.0f, 1.0f, 1.0f, 1.0f};

// Sum of a ball's coverage times value over the voxels [first, last) of a row; v is the row's element 0, were it there.
// What is known to be 0 is left out, and what is known to be 1 is not read: no bit of the sum is another for it.
static double ball_sum(double radius, double across2, double z, int64_t first, int64_t last, const float *v,
                       const Known *known, int64_t *read) {
    const double outer2 = (radius + 0.5) * (radius + 0.5);
    if (across2 >= outer2) return 0.0;
    const double half = sqrt(outer2 - across2);
    const int64_t end = least(last, floor_of(z + half) + 1), begin = most(first, ceil_of(z - half));
    if (begin >= end || is_empty(known, begin, end)) return 0.0;
    // As long as a multiple of LANES, where the row allows: what is added is not covered and changes no sum.
    const int64_t low = most(first, end - whole_lanes(end - begin)), high = least(last, low + whole_lanes(end - low));
    const int64_t whole = low + (high - low) / LANES * LANES, stop = least(whole, known->some_end);
    float lanes[LANES] = {0.0f};
    double sum = 0.0;
    int64_t k = low;
    while (k + LANES <= known->some) k += LANES;
    if (is_full(known, low, whole)) {
        for (; k < stop; k += LANES) add_covered((float)radius, (float)across2, (float)((double)k - z), ones, lanes);
    } else {
        *read += most(0, stop - k);
        for (; k < stop; k += LANES) add_covered((float)radius, (float)across2, (float)((double)k - z), v + k, lanes);
    }
    for (k = whole; k < high; k++)
        sum += coverage_at(sqrt(across2 + ((double)k - z) * ((double)k - z)) - radius) * (double)v[k];
    for (int l = 0; l < LANES / 2; l++) lanes[l] += lanes[l + LANES / 2];
    for (int l = 0; l < LANES / 2; l++) sum += (double)lanes[l];
    return sum;
}

// The same for any shape.
static double covered_sum(const Shape *s, double x, double y, double z, int64_t first, int64_t last, const float *v,
                          const Known *known, int64_t *read) {
    if (s->ball) return ball_sum(s->radius, x * x + y * y, z, first, last, v, known, read);
    const Span span = row_span(s, x, y, z, last);
    double sum = 0.0;
    *read += most(0, span.high - most(first, span.low));
    for (int64_t k = most(first, span.low); k < span.high; k++)
        if (v[k] > 0.0f) sum += coverage(s, x, y, (double)k - z) * (double)v[k];
    return sum;
}

static void box_of(const Shape *s, const double centre[3], const int64_t shape[3], int64_t low[3], int64_t high[3]) {
    for (int a = 0; a < 3; a++) {
        low[a] = floor_of(clamp(centre[a] - extent(s, a) - 0.5, 0.0, (double)shape[a]));
        high[a] = least(shape[a], ceil_of(clamp(centre[a] + extent(s, a) + 0.5, -1.0, (double)shape[a])) + 1);
    }
}

// The place of a voxel from its flat index.
static void voxel_at(const Grid *g, int64_t index, int64_t at[3]) {
    at[2] = index % g->shape[2];
    at[1] = index / g->shape[2] % g->shape[1];
    at[0] = index / g->shape[2] / g->shape[1];
}

// Before-images of bricks (core/history.py), and boxes around what was written.

static void copy_brick(const Grid *g, int64_t bi, int64_t bj, int64_t bk, float *image) {
    const int64_t n = least(BRICK, g->shape[2] - bk * BRICK);
    for (int64_t i = bi * BRICK; i < least((bi + 1) * BRICK, g->shape[0]); i++)
        for (int64_t j = bj * BRICK; j < least((bj + 1) * BRICK, g->shape[1]); j++)
            memcpy(image + ((i - bi * BRICK) * BRICK + (j - bj * BRICK)) * BRICK,
                   g->density + (i * g->shape[1] + j) * g->shape[2] + bk * BRICK, (size_t)n * sizeof(float));
}

// Of a brick that is known to be empty or full no image is needed.
static void keep_brick(Grid *g, int64_t brick, int64_t bi, int64_t bj, int64_t bk) {
    if (g->kept[brick]) return;
    g->kept[brick] = 1;
    const int known = g->states && g->states[brick] != MIXED;
    if (!known) copy_brick(g, bi, bj, bk, g->images + (*g->image_count)++ * (BRICK * BRICK * BRICK));
    g->bricks[*g->kept_count] = brick;
    g->entries[*g->kept_count] = known ? -1 - g->states[brick] : *g->image_count;
    // Another thread may ask what was here (History.original): the image is whole before it is counted, and counted
    // before the brick is written.
    __atomic_thread_fence(__ATOMIC_RELEASE);
    __atomic_store_n(g->kept_count, *g->kept_count + 1, __ATOMIC_RELAXED);
    __atomic_thread_fence(__ATOMIC_RELEASE);
}

// Before any voxel of the box is written, its bricks are copied, the first time in a stroke, and marked.
static void keep_box(Grid *g, int64_t i0, int64_t i1, int64_t j0, int64_t j1, int64_t k0, int64_t k1) {
    const int64_t nj = (g->shape[1] + BRICK - 1) / BRICK, nk = (g->shape[2] + BRICK - 1) / BRICK;
    for (int64_t bi = i0 / BRICK; bi <= (i1 - 1) / BRICK; bi++)
        for (int64_t bj = j0 / BRICK; bj <= (j1 - 1) / BRICK; bj++)
            for (int64_t bk = k0 / BRICK; bk <= (k1 - 1) / BRICK; bk++) {
                const int64_t brick = (bi * nj + bj) * nk + bk;
                if (g->kept) keep_brick(g, brick, bi, bj, bk);
                if (g->states) g->states[brick] = MIXED;
            }
}

static void mark_dirty(int64_t dirty[6], int64_t i0, int64_t i1, int64_t j0, int64_t j1, int64_t k0, int64_t k1) {
    const int64_t low[3] = {i0, j0, k0}, high[3] = {i1, j1, k1};
    for (int a = 0; a < 3; a++) {
        dirty[a] = least(dirty[a], low[a]);
        dirty[3 + a] = most(dirty[3 + a], high[a]);
    }
}

// What bricks hold (core/bricks.py).

static int all_equal(const float *d, int64_t n, uint32_t word) {
    uint32_t bits = 0, other;
    for (int64_t k = 0; k < n; k++) {
        memcpy(&other, d + k, sizeof other);
        bits |= other ^ word;
    }
    return bits == 0;
}

static int all_full(const float *d, int64_t n) {
    const float one = 1.0f;
    uint32_t full;
    memcpy(&full, &one, sizeof full);
    return all_equal(d, n, full);
}

static uint8_t state_of(const float *density, const int64_t shape[3], int64_t bi, int64_t bj, int64_t bk) {
    const int64_t n = least(BRICK, shape[2] - bk * BRICK);
    const float first = density[(bi * BRICK * shape[1] + bj * BRICK) * shape[2] + bk * BRICK];
    const uint8_t state = first == 1.0f ? FULL : EMPTY;
    for (int64_t i = bi * BRICK; i < least((bi + 1) * BRICK, shape[0]); i++)
        for (int64_t j = bj * BRICK; j < least((bj + 1) * BRICK, shape[1]); j++) {
            const float *d = density + (i * shape[1] + j) * shape[2] + bk * BRICK;
            if (!(state == FULL ? all_full(d, n) : all_equal(d, n, 0))) return MIXED;
        }
    return state;
}

// Find out what the marked bricks from `first` up to `last` (indices of bricks) are; returns how many those were.
EXPORT int64_t repousse_classify(const float *density, const int64_t shape[3], uint8_t *states, const int64_t first[3],
                                 const int64_t last[3]) {
    const int64_t nj = (shape[1] + BRICK - 1) / BRICK, nk = (shape[2] + BRICK - 1) / BRICK;
    int64_t marked = 0;
    for (int64_t bi = first[0]; bi < last[0]; bi++)
        for (int64_t bj = first[1]; bj < last[1]; bj++)
            for (int64_t bk = first[2]; bk < last[2]; bk++) {
                uint8_t *state = states + (bi * nj + bj) * nk + bk;
                if (*state != MIXED) continue;
                *state = state_of(density, shape, bi, bj, bk);
                marked++;
            }
    return marked;
}

// Estimate (core/plasticity.py).

// The rows of plane i that a shape may reach, half open.
static void rows_of(const Shape *s, const double centre[3], int64_t i, int64_t n, int64_t *low, int64_t *high) {
    const double x = (double)i - centre[0], outer = s->radius + 0.5;
    const double half = !s->ball ? extent(s, 1) + 0.5 : fabs(x) < outer ? sqrt(outer * outer - x * x) : -1.0;
    *low = most(0, ceil_of(centre[1] - half));
    *high = least(n, floor_of(centre[1] + half) + 1);
}

static int64_t shell_count(const Tool *t) {
    const double deepest = fmin(fmin(extent(&t->volume, 0), extent(&t->volume, 1)), extent(&t->volume, 2));
    return least(MAX_SHELLS, (int64_t)((deepest + 0.5) / SHELL) + 2);
}

// Shells are counted inward from the tool's skin.
static int64_t shell_of(double distance_, int64_t shells) {
    return least((int64_t)((0.5 - distance_) / SHELL), shells - 1);
}

// The voxels of a ball's row that it covers wholly: of `span`, all but its two ends.
static Span ball_core(double radius, double across2, double z, Span span) {
    const double inner2 = (radius - 0.5) * (radius - 0.5);
    if (across2 >= inner2) return (Span){span.high, span.high};
    const double half = sqrt(inner2 - across2);
    const int64_t low = within(ceil_of(z - half), span.low, span.high);
    return (Span){low, within(floor_of(z + half) + 1, low, span.high)};
}

// A stretch of a ball's row at its skin: M_t gains w d, and grad M_t gains d n where 0 < w < 1, n the outward normal.
static void weigh_skin(double radius, double x, double y, double z, Span span, const float *d, Estimate *out) {
    double flat = 0.0, along = 0.0;
    for (int64_t k = span.low; k < span.high; k++) {
        if (d[k] <= 0.0f) continue;
        const double at = (double)k - z, root = sqrt(x * x + y * y + at * at), w = coverage_at(root - radius);
        const double part = w > 0.0 && w < 1.0 ? (double)d[k] / root : 0.0;
        out->tool_mass += w * (double)d[k];
        flat += part;
        along += part * at;
    }
    out->gradient[0] += x * flat;
    out->gradient[1] += y * flat;
    out->gradient[2] += along;
}

// The same for any shape.
static void weigh_stretch(const Shape *s, double x, double y, double z, Span span, const float *d, Estimate *out) {
    double n[3];
    for (int64_t k = span.low; k < span.high; k++) {
        if (d[k] <= 0.0f) continue;
        const double at = (double)k - z, w = coverage(s, x, y, at);
        out->tool_mass += w * (double)d[k];
        if (w >= 1.0) continue;
        normal(s, x, y, at, n);
        for (int a = 0; a < 3; a++) out->gradient[a] += (double)d[k] * n[a];
    }
}

// The sum of a row's wholly covered voxels.
static double core_sum(const float *d, Span core, const Known *known, int64_t *read) {
    const int64_t n = core.high - core.low;
    if (is_full(known, core.low, core.high)) return (double)n;
    *read += n;
    return row_sum(d + core.low, n);
}

static void weigh_row(const Shape *s, double x, double y, double z, int64_t n, const float *d, const Known *known,
                      Estimate *out) {
    const Span span = row_span(s, x, y, z, n);
    if (!s->ball) {
        out->read += span.high - span.low;
        weigh_stretch(s, x, y, z, span, d, out);
        return;
    }
    const Span core = ball_core(s->radius, x * x + y * y, z, span);
    out->read += span.high - span.low - (core.high - core.low);
    weigh_skin(s->radius, x, y, z, (Span){span.low, core.low}, d, out);
    out->tool_mass += core_sum(d, core, known, &out->read);
    weigh_skin(s->radius, x, y, z, (Span){core.high, span.high}, d, out);
}

static void weigh_tool(const Grid *g, const Tool *t, Estimate *out) {
    int64_t low[3], high[3], first, last;
    box_of(&t->volume, t->centre, g->shape, low, high);
    for (int64_t i = low[0]; i < high[0]; i++) {
        Known known = nothing_known;
        rows_of(&t->volume, t->centre, i, g->shape[1], &first, &last);
        for (int64_t j = first; j < last; j++) {
            if (j == first || j % BRICK == 0) known = known_of(g, i, j, low[2], high[2]);
            const float *d = g->density + (i * g->shape[1] + j) * g->shape[2];
            if (!any_in(&known, d, low[2], high[2], &out->read)) continue; // most of a tool has been emptied
            weigh_row(&t->volume, (double)i - t->centre[0], (double)j - t->centre[1], t->centre[2], g->shape[2], d,
                      &known, out);
        }
    }
}

// M_t = sum w_t d, M_s = sum (w_s - w_t) d, and grad M_t (paper equations 4, 5).
EXPORT void repousse_estimate(const Grid *g, const Tool *t, Estimate *out) {
    int64_t low[3], high[3], first, last;
    double both = 0.0;
    memset(out, 0, sizeof *out);
    weigh_tool(g, t, out);
    box_of(&t->surroundings, t->centre, g->shape, low, high);
    for (int64_t i = low[0]; i < high[0]; i++) {
        const double x = (double)i - t->centre[0];
        Known known = nothing_known;
        rows_of(&t->surroundings, t->centre, i, g->shape[1], &first, &last);
        for (int64_t j = first; j < last; j++) {
            if (j == first || j % BRICK == 0) known = known_of(g, i, j, low[2], high[2]);
            if (is_empty(&known, low[2], high[2])) continue;
            const float *d = g->density + (i * g->shape[1] + j) * g->shape[2];
            both += covered_sum(&t->surroundings, x, (double)j - t->centre[1], t->centre[2], 0, g->shape[2], d, &known,
                                &out->read);
        }
    }
    out->reach_mass = both - out->tool_mass;
}

// The push's frame: axes in the order of the sweep.

// Axes in the order (a, b, c): a is swept along, rows run along c, which is contiguous unless a is axis 2.
typedef struct {
    int axis[3];
    int64_t n[3], stride[3];
    double centre[3];
    Shape volume, surroundings;
} Frame;

static void permute(const Shape *s, const int axis[3], Shape *out) {
    for (int i = 0; i < 3; i++) {
        out->half_size[i] = s->half_size[axis[i]];
        out->half_axis[i] = s->half_axis[axis[i]];
    }
    out->radius = s->radius;
    out->ball = s->ball;
}

static Frame frame_of(const Grid *g, const Tool *t, int64_t dominant) {
    static const int orders[3][3] = {{0, 1, 2}, {1, 0, 2}, {2, 0, 1}};
    const int64_t strides[3] = {g->shape[1] * g->shape[2], g->shape[2], 1};
    Frame f;
    for (int i = 0; i < 3; i++) {
        const int axis = orders[dominant][i];
        f.axis[i] = axis;
        f.n[i] = g->shape[axis];
        f.stride[i] = strides[axis];
        f.centre[i] = t->centre[axis];
    }
    permute(&t->volume, f.axis, &f.volume);
    permute(&t->surroundings, f.axis, &f.surroundings);
    return f;
}

static float *emptied_at(const Emptied *e, int64_t a, int64_t b, int64_t c) {
    return e->buffer + ((a - e->low[0]) * e->n[1] + (b - e->low[1])) * e->n[2] + (c - e->low[2]);
}

// Empty, and put back (core/dispersion.py).

// What a voxel can give: the share of its mass inside the tool, w d. Packed material first fills the part of its voxel
// that the tool leaves free, so it gives only d - (1 - w): then a tool that passes twice finds nothing more to take.
static double available(float d, double w, int64_t packed) {
    return packed ? fmax((double)d - (1.0 - w), 0.0) : w * (double)d;
}

typedef struct {
    int64_t last; // the shell of which a part is taken; all deeper ones are emptied
    double part;
} Cut;

static Cut cut_for(const double *mass, int64_t shells, double wanted) {
    double taken = 0.0;
    for (int64_t s = shells - 1; s >= 0; s--) {
        if (mass[s] <= 0.0) continue;
        if (taken + mass[s] >= wanted) return (Cut){s, (wanted - taken) / mass[s]};
        taken += mass[s];
    }
    return (Cut){0, 1.0};
}

// Float32 rounds all alike in uniform material, so its errors add up unless they are moved on: to the largest source.
static void send_carry(Emptied *e, float *largest) {
    const double former = (double)*largest;
    *largest = (float)fmax(former + e->carry, 0.0);
    const double sent = (double)*largest - former;
    e->mass += sent;
    e->carry -= sent;
}

// The tool's voxels that hold density, for the two looks that follow: weigh the shells, then take.
static int64_t list_occupied(const Grid *g, const Tool *t, int64_t shells, Occupied *list) {
    int64_t low[3], high[3], count = 0, first, last, read = 0;
    box_of(&t->volume, t->centre, g->shape, low, high);
    for (int64_t i = low[0]; i < high[0]; i++) {
        const double x = (double)i - t->centre[0];
        Known known = nothing_known;
        rows_of(&t->volume, t->centre, i, g->shape[1], &first, &last);
        for (int64_t j = first; j < last; j++) {
            const double y = (double)j - t->centre[1], z = t->centre[2];
            const int64_t row = (i * g->shape[1] + j) * g->shape[2];
            const float *d = g->density + row;
            if (j == first || j % BRICK == 0) known = known_of(g, i, j, low[2], high[2]);
            if (!any_in(&known, d, low[2], high[2], &read)) continue;
            const Span span = row_span(&t->volume, x, y, z, g->shape[2]);
            for (int64_t k = span.low; k < span.high; k++) {
                if (d[k] <= 0.0f) continue;
                const double far = distance(&t->volume, x, y, (double)k - z);
                list[count++] = (Occupied){row + k, shell_of(far, shells), coverage_at(far)};
            }
        }
    }
    return count;
}

static void nothing_emptied(Emptied *e) {
    for (int i = 0; i < 3; i++) {
        e->first[i] = INT64_MAX;
        e->last[i] = INT64_MIN;
    }
    e->mass = e->tool_loss = e->reach_loss = 0.0;
}

// Take mass from one of the tool's voxels into the record; returns where it is recorded.
ALWAYS_INLINE float *take(Grid *g, const Tool *t, const Frame *f, Emptied *e, const Occupied *o, float taken) {
    float *d = g->density + o->index;
    const double w = o->covered, former = (double)*d;
    int64_t at[3];
    voxel_at(g, o->index, at);
    keep_box(g, at[0], at[0] + 1, at[1], at[1] + 1, at[2], at[2] + 1);
    *d = (float)(former - (double)taken);
    e->carry += former - (double)*d - (double)taken;
    e->mass += (double)taken;
    e->tool_loss += w * (double)taken;
    // A voxel wholly in the tool is wholly in the tool and its reach together.
    const double around = w >= 1.0 ? 1.0
                                   : coverage(&t->surroundings, (double)at[0] - t->centre[0],
                                              (double)at[1] - t->centre[1], (double)at[2] - t->centre[2]);
    e->reach_loss += (around - w) * (double)taken;
    float *record = emptied_at(e, at[f->axis[0]], at[f->axis[1]], at[f->axis[2]]);
    *record = taken;
    for (int slot = 0; slot < 3; slot++) {
        e->first[slot] = least(e->first[slot], at[f->axis[slot]]);
        e->last[slot] = most(e->last[slot], at[f->axis[slot]] + 1);
    }
    return record;
}

// Take mass from the innermost shells of the tool until M_t has fallen by `wanted` (paper 7, steps 2 and 4).
EXPORT void repousse_empty(Grid *g, const Tool *t, double wanted, int64_t packed, Emptied *e) {
    const Frame f = frame_of(g, t, e->axis);
    double mass[MAX_SHELLS];
    const int64_t shells = shell_count(t), count = list_occupied(g, t, shells, e->occupied);
    memset(mass, 0, (size_t)shells * sizeof(double));
    for (int64_t q = 0; q < count; q++) {
        const Occupied *o = e->occupied + q;
        mass[o->shell] += o->covered * available(g->density[o->index], o->covered, packed);
    }
    const Cut cut = cut_for(mass, shells, wanted);
    nothing_emptied(e);
    float *largest = NULL;
    for (int64_t q = 0; q < count; q++) {
        const Occupied *o = e->occupied + q;
        if (o->shell < cut.last) continue;
        const double part = o->shell > cut.last ? 1.0 : cut.part;
        const float taken = (float)(part * available(g->density[o->index], o->covered, packed));
        if (taken <= 0.0f) continue;
        float *record = take(g, t, &f, e, o, taken);
        if (!largest || taken > *largest) largest = record;
    }
    if (largest) send_carry(e, largest);
}

// Sums of d and of d^2 over the tool with its reach (0, 1) and over the tool alone (2, 3), each voxel weighed by how far
// behind the tool it is: (1 - p.u / front)^16, which is 0 straight ahead. `row` is scratch.
EXPORT void repousse_behind(const Grid *g, const Tool *t, const double u[3], double front, float *row, double sums[4]) {
    const Shape *shapes[2] = {&t->surroundings, &t->volume};
    const double z = t->centre[2];
    int64_t low[3], high[3], first, last, read = 0;
    box_of(&t->surroundings, t->centre, g->shape, low, high);
    for (int q = 0; q < 4; q++) sums[q] = 0.0;
    for (int64_t i = low[0]; i < high[0]; i++) {
        const double x = (double)i - t->centre[0];
        Known known = nothing_known;
        rows_of(&t->surroundings, t->centre, i, g->shape[1], &first, &last);
        for (int64_t j = first; j < last; j++) {
            const float *d = g->density + (i * g->shape[1] + j) * g->shape[2];
            if (j == first || j % BRICK == 0) known = known_of(g, i, j, low[2], high[2]);
            if (is_empty(&known, low[2], high[2])) continue;
            const double y = (double)j - t->centre[1];
            const float at = (float)(1.0 - (x * u[0] + y * u[1] - z * u[2]) / front), slope = (float)(u[2] / front);
            for (int64_t k = low[2]; k < high[2]; k++) {
                float behind = at - slope * (float)k;
                for (int squared = 0; squared < 4; squared++) behind *= behind;
                row[k] = behind * d[k];
            }
            for (int q = 0; q < 4; q++) {
                if (q == 2)
                    for (int64_t k = low[2]; k < high[2]; k++) row[k] *= d[k];
                sums[q / 2 + q % 2 * 2] +=
                    covered_sum(shapes[q % 2], x, y, z, low[2], high[2], row, &nothing_known, &read);
            }
        }
    }
}

// Take from each voxel of the tool what it has above its level, dense (1 - w strength): the fullest give most, none is
// hollowed out, and a tool that passes twice finds nothing more to take.
EXPORT void repousse_loosen(Grid *g, const Tool *t, double dense, double strength, Emptied *e) {
    const Frame f = frame_of(g, t, e->axis);
    const int64_t count = list_occupied(g, t, shell_count(t), e->occupied);
    nothing_emptied(e);
    float *largest = NULL;
    for (int64_t q = 0; q < count; q++) {
        const Occupied *o = e->occupied + q;
        const double above = (double)g->density[o->index] - dense * (1.0 - o->covered * strength);
        if (above <= LEAST_GIVEN) continue;
        float *record = take(g, t, &f, e, o, (float)above);
        if (!largest || *record > *largest) largest = record;
    }
    if (largest) send_carry(e, largest);
}

// Zero the part of the buffer that was used, so that it need not be cleared as a whole.
EXPORT void repousse_clear(Emptied *e) {
    for (int64_t a = e->first[0]; a < e->last[0]; a++)
        for (int64_t b = e->first[1]; b < e->last[1]; b++)
            memset(emptied_at(e, a, b, e->first[2]), 0, (size_t)(e->last[2] - e->first[2]) * sizeof(float));
}

// Return mass to the voxels that it was taken from, outermost shells first, each voxel of a shell by the same part.
EXPORT void repousse_put_back(Grid *g, const Tool *t, double amount, Emptied *e) {
    const Frame f = frame_of(g, t, e->axis);
    double mass[MAX_SHELLS];
    const int64_t shells = shell_count(t);
    memset(mass, 0, (size_t)shells * sizeof(double));
    double tool_gain = 0.0, reach_gain = 0.0;
    Cut cut = {0, 0.0};
    for (int pass = 0; pass < 2; pass++) {
        for (int64_t a = e->first[0]; a < e->last[0]; a++)
            for (int64_t b = e->first[1]; b < e->last[1]; b++)
                for (int64_t c = e->first[2]; c < e->last[2]; c++) {
                    const float taken = *emptied_at(e, a, b, c);
                    if (taken <= 0.0f) continue;
                    const double x = (double)a - f.centre[0], y = (double)b - f.centre[1], z = (double)c - f.centre[2];
                    const double far = distance(&f.volume, x, y, z);
                    const int64_t shell = shells - 1 - shell_of(far, shells); // outermost first
                    float *d = g->density + a * f.stride[0] + b * f.stride[1] + c * f.stride[2];
                    // The rim may have used some of the room that the tool left in a voxel of its skin.
                    const double fits = fmin((double)taken, 1.0 - (double)*d);
                    if (pass == 0) {
                        mass[shell] += fits;
                        continue;
                    }
                    if (shell < cut.last) continue;
                    const double part = shell > cut.last ? 1.0 : cut.part, w = coverage_at(far), back = part * fits;
                    const double former = (double)*d;
                    *d = (float)(former + back);
                    amount -= (double)*d - former;
                    tool_gain += w * back;
                    reach_gain += (coverage(&f.surroundings, x, y, z) - w) * back;
                }
        if (pass == 0) cut = cut_for(mass, shells, amount);
    }
    e->carry += amount;
    e->tool_loss -= tool_gain;
    e->reach_loss -= reach_gain;
}

// Sweep (core/dispersion.py).

// Columns along axis 2 are far apart in memory, so planes across it are read and written a cache line at a time.
typedef struct {
    int64_t plane, planes, b0, b1, c0, c1; // what the slab holds; planes = 0 when it holds nothing
    int64_t dirty_a0, dirty_a1, dirty_b0, dirty_b1, dirty_c0, dirty_c1;
} Slab;

static float *slab_row(const Sweep *s, const Slab *slab, int64_t plane, int64_t b) {
    return s->slab + ((plane - slab->plane) * (slab->b1 - slab->b0) + (b - slab->b0)) * (slab->c1 - slab->c0) -
           slab->c0;
}

// Where in the slab each of its planes has row b.
static void slab_rows(const Sweep *s, const Slab *slab, int64_t b, float *rows[SLAB_PLANES]) {
    for (int64_t q = 0; q < slab->planes; q++) rows[q] = slab_row(s, slab, slab->plane + q, b);
}

static void nothing_dirty(Slab *slab) {
    slab->dirty_a0 = slab->dirty_b0 = slab->dirty_c0 = INT64_MAX;
    slab->dirty_a1 = slab->dirty_b1 = slab->dirty_c1 = INT64_MIN;
}

static void flush_slab(Grid *g, const Frame *f, const Sweep *s, Slab *slab) {
    float *rows[SLAB_PLANES];
    if (slab->planes && slab->dirty_b0 < slab->dirty_b1) {
        const int64_t first = slab->dirty_a0 - slab->plane, last = slab->dirty_a1 - slab->plane;
        keep_box(g, slab->dirty_b0, slab->dirty_b1, slab->dirty_c0, slab->dirty_c1, slab->dirty_a0, slab->dirty_a1);
        for (int64_t b = slab->dirty_b0; b < slab->dirty_b1; b++) {
            slab_rows(s, slab, b, rows);
            for (int64_t c = slab->dirty_c0; c < slab->dirty_c1; c++) {
                float *d = g->density + b * f->stride[1] + c * f->stride[2] + slab->plane;
                for (int64_t q = first; q < last; q++) d[q] = rows[q][c];
            }
        }
    }
    slab->planes = 0;
}

// Read the planes that are still ahead of those that share this one's cache line.
static void load_slab(Grid *g, const Frame *f, const Sweep *s, Slab *slab, int64_t plane) {
    const int64_t *w = s->window, line = plane / SLAB_PLANES * SLAB_PLANES;
    const int64_t lead_b = SLAB_PLANES * s->shift[0], lead_c = SLAB_PLANES * s->shift[1];
    const int forward = s->direction[f->axis[0]] >= 0.0;
    float *rows[SLAB_PLANES];
    flush_slab(g, f, s, slab);
    slab->plane = forward ? plane : line;
    slab->planes = (forward ? least(line + SLAB_PLANES, f->n[0]) : plane + 1) - slab->plane;
    slab->b0 = most(0, w[0] - SLAB_MARGIN + least(0, lead_b));
    slab->b1 = least(f->n[1], w[1] + SLAB_MARGIN + most(0, lead_b));
    slab->c0 = most(0, w[2] - SLAB_MARGIN + least(0, lead_c));
    slab->c1 = least(f->n[2], w[3] + SLAB_MARGIN + most(0, lead_c));
    nothing_dirty(slab);
    for (int64_t b = slab->b0; b < slab->b1; b++) {
        slab_rows(s, slab, b, rows);
        for (int64_t c = slab->c0; c < slab->c1; c++) {
            const float *d = g->density + b * f->stride[1] + c * f->stride[2] + slab->plane;
            for (int64_t q = 0; q < slab->planes; q++) rows[q][c] = d[q];
        }
    }
}

static int slab_holds(const Slab *slab, const int64_t w[4], int64_t plane) {
    return plane >= slab->plane && plane < slab->plane + slab->planes && w[0] >= slab->b0 && w[1] <= slab->b1 &&
           w[2] >= slab->c0 && w[3] <= slab->c1;
}

static float *flux_at(const Sweep *s, int64_t b, int64_t c) {
    return s->flux + (b - s->origin[0]) * s->stride + (c - s->origin[1]);
}

// Around what it holds the flux buffer has FRAME cells of zeros, and more at the rows' ends, so that spreading has no
// edge cases and works in whole LANES.
static void lay_buffer(Sweep *s, float *buffer, const int64_t window[4]) {
    s->flux = buffer;
    memcpy(s->window, window, sizeof s->window);
    s->origin[0] = window[0] - FRAME;
    s->origin[1] = window[2] - FRAME;
    s->stride = whole_lanes(window[3] - window[2]) + 2 * FRAME + LANES;
    memset(buffer, 0, (size_t)((window[1] - window[0] + 2 * FRAME) * s->stride) * sizeof(float));
}

// flux'(b, c) = sum of w(i, j) flux(b - i, c - j): one row from the three around it.
static void spread_row(const float w[9], const float *restrict above, const float *restrict here,
                       const float *restrict below, int64_t n, float *restrict to) {
    for (int64_t k = 0; k < whole_lanes(n); k++)
        to[k] = w[0] * above[k + 2] + w[1] * above[k + 1] + w[2] * above[k] + w[3] * here[k + 2] + w[4] * here[k + 1] +
                w[5] * here[k] + w[6] * below[k + 2] + w[7] * below[k + 1] + w[8] * below[k];
}

// One plane on: the flux is sheared and spread by the 3x3 kernel, and the window made to hold this plane's sources too.
static void spread(Sweep *s, const Emptied *e, int has_sources) {
    const Sweep former = *s;
    const int64_t *w = former.window;
    const int under_way = w[0] < w[1];
    const int64_t b0 = w[0] + s->shift[0] - 1, b1 = w[1] + s->shift[0] + 1, c0 = w[2] + s->shift[1] - 1,
                  c1 = w[3] + s->shift[1] + 1;
    int64_t grown[4] = {INT64_MAX, INT64_MIN, INT64_MAX, INT64_MIN};
    if (under_way) memcpy(grown, (int64_t[4]){b0, b1, c0, c1}, sizeof grown);
    for (int i = 0; i < 2 && has_sources; i++) {
        grown[2 * i] = least(grown[2 * i], e->first[1 + i]);
        grown[2 * i + 1] = most(grown[2 * i + 1], e->last[1 + i]);
    }
    lay_buffer(s, former.next, grown);
    s->next = former.flux;
    for (int64_t b = b0; b < b1 && under_way; b++) {
        const int64_t source = b - s->shift[0], column = w[2] - FRAME;
        spread_row(s->weights, flux_at(&former, source + 1, column), flux_at(&former, source, column),
                   flux_at(&former, source - 1, column), c1 - c0, flux_at(s, b, c0));
    }
}

static void add_sources(Sweep *s, const Emptied *e) {
    for (int64_t b = e->first[1]; b < e->last[1]; b++) {
        const float *source = emptied_at(e, s->plane, b, e->first[2]);
        float *flux = flux_at(s, b, e->first[2]);
        for (int64_t c = 0; c < e->last[2] - e->first[2]; c++) flux[c] += source[c];
    }
}

static void fold_row(Sweep *s, int64_t from, int64_t to) {
    for (int64_t c = s->window[2]; c < s->window[3]; c++) {
        *flux_at(s, to, c) += *flux_at(s, from, c);
        *flux_at(s, from, c) = 0.0f;
    }
}

static void fold_column(Sweep *s, int64_t from, int64_t to) {
    for (int64_t b = s->window[0]; b < s->window[1]; b++) {
        *flux_at(s, b, to) += *flux_at(s, b, from);
        *flux_at(s, b, from) = 0.0f;
    }
}

static int faint(const Sweep *s, int64_t b0, int64_t b1, int64_t c0, int64_t c1) {
    for (int64_t b = b0; b < b1; b++)
        for (int64_t c = c0; c < c1; c++)
            if (*flux_at(s, b, c) >= NEGLIGIBLE) return 0;
    return 1;
}

// Fold edges whose flux is negligible inward; all four are judged before any is moved, so that mirrors stay mirrors.
static void trim(Sweep *s) {
    int64_t *w = s->window;
    for (;;) {
        const int b_low = faint(s, w[0], w[0] + 1, w[2], w[3]), b_high = faint(s, w[1] - 1, w[1], w[2], w[3]);
        const int c_low = faint(s, w[0], w[1], w[2], w[2] + 1), c_high = faint(s, w[0], w[1], w[3] - 1, w[3]);
        const int fold_b = w[1] - w[0] > b_low + b_high, fold_c = w[3] - w[2] > c_low + c_high;
        if (!((b_low || b_high) && fold_b) && !((c_low || c_high) && fold_c)) return;
        if (fold_b && b_low) {
            fold_row(s, w[0], w[0] + 1);
            w[0]++;
        }
        if (fold_b && b_high) {
            fold_row(s, w[1] - 1, w[1] - 2);
            w[1]--;
        }
        if (fold_c && c_low) {
            fold_column(s, w[2], w[2] + 1);
            w[2]++;
        }
        if (fold_c && c_high) {
            fold_column(s, w[3] - 1, w[3] - 2);
            w[3]--;
        }
    }
}

static double take_flux(Sweep *s, int64_t b0, int64_t b1, int64_t c0, int64_t c1) {
    double sum = 0.0;
    for (int64_t b = b0; b < b1; b++) {
        sum += row_sum(flux_at(s, b, c0), c1 - c0);
        memset(flux_at(s, b, c0), 0, (size_t)(c1 - c0) * sizeof(float));
    }
    return sum;
}

// One edge row (side 0) or column (side 1) that lies outside the plane: at an open border it leaves and is counted, at
// a wall it is turned back onto its neighbour. A window one voxel wide has no neighbour: it is moved as a whole.
static void bring_back(Sweep *s, int side, int at_high) {
    int64_t *low = &s->window[2 * side], *high = &s->window[2 * side + 1];
    const int64_t edge = at_high ? *high - 1 : *low, inward = at_high ? edge - 1 : edge + 1;
    if (s->border == OPEN) {
        s->mass_out += side ? take_flux(s, s->window[0], s->window[1], edge, edge + 1)
                            : take_flux(s, edge, edge + 1, s->window[2], s->window[3]);
    } else if (*high - *low == 1) {
        s->origin[side] += inward - edge;
        *low = inward;
        *high = inward + 1;
        return;
    } else if (side) {
        fold_column(s, edge, inward);
    } else {
        fold_row(s, edge, inward);
    }
    if (at_high) --*high;
    else ++*low;
}

static void apply_border(Sweep *s, const Frame *f) {
    for (int side = 0; side < 2; side++) {
        const int64_t *low = &s->window[2 * side], *high = &s->window[2 * side + 1];
        while (*low < *high && *low < 0) bring_back(s, side, 0);
        while (*low < *high && *high > f->n[1 + side]) bring_back(s, side, 1);
    }
}

static int64_t ask_growth(Sweep *s, const Frame *f, int below_a, int above_a) {
    const int64_t *w = s->window;
    const int64_t asked[6] = {below_a, above_a, w[0]<0, w[1]> f->n[1], w[2]<0, w[3]> f->n[2]};
    int any = 0;
    for (int i = 0; i < 3; i++) {
        s->needs[2 * f->axis[i]] = asked[2 * i] != 0;
        s->needs[2 * f->axis[i] + 1] = asked[2 * i + 1] != 0;
        any |= asked[2 * i] || asked[2 * i + 1];
    }
    return any;
}

// What has gone farther along u than the band lets it is surplus. Returns whether any flux goes on.
static int stop_at_band(Sweep *s, const Frame *f) {
    const double ua = s->direction[f->axis[0]], ub = s->direction[f->axis[1]], uc = s->direction[f->axis[2]];
    const int64_t *w = s->window;
    const double ahead = ua * ((double)s->plane - f->centre[0]);
    const double farthest = ahead + fmax(ub * ((double)w[0] - f->centre[1]), ub * ((double)(w[1] - 1) - f->centre[1])) +
                            fmax(uc * ((double)w[2] - f->centre[2]), uc * ((double)(w[3] - 1) - f->centre[2]));
    if (farthest <= s->limit) return 1;
    int goes_on = 0;
    for (int64_t b = w[0]; b < w[1]; b++) {
        const double row = ahead + ub * ((double)b - f->centre[1]);
        for (int64_t c = w[2]; c < w[3]; c++) {
            float *flux = flux_at(s, b, c);
            if (*flux <= 0.0f) continue;
            if (row + uc * ((double)c - f->centre[2]) > s->limit) {
                s->surplus += (double)*flux;
                *flux = 0.0f;
            } else {
                goes_on = 1;
            }
        }
    }
    return goes_on;
}

// deposit = min(flux, 1 - d), for a row.
static void deposit(const float *restrict d, const float *restrict flux, int64_t n, float *restrict laid) {
    for (int64_t k = 0; k < n; k++) {
        const float room = 1.0f - d[k];
        laid[k] = flux[k] < room ? flux[k] : room;
    }
}

// Lay it down; returns the mass that the row gained, rounding included.
static double lay_down(float *restrict d, float *restrict flux, int64_t n, const float *restrict laid) {
    double lanes[LANES] = {0.0};
    int64_t k = 0;
    for (; k + LANES <= n; k += LANES)
        for (int l = 0; l < LANES; l++) {
            const float former = d[k + l], raised = former + laid[k + l];
            lanes[l] += (double)raised - (double)former;
            d[k + l] = raised;
            flux[k + l] -= laid[k + l];
        }
    for (; k < n; k++) {
        const float former = d[k];
        d[k] += laid[k];
        lanes[0] += (double)d[k] - (double)former;
        flux[k] -= laid[k];
    }
    return lane_sum(lanes);
}

// What M_s gains from a row that gained `gained` in all.
static double reach_gain(const Frame *f, double x, double y, const float *laid, int64_t first, int64_t last,
                         double gained) {
    const double z = f->centre[2], inner = f->surroundings.radius - 0.5;
    const double farthest = fmax(fabs((double)first - z), fabs((double)(last - 1) - z));
    if (f->surroundings.ball && x * x + y * y + farthest * farthest <= inner * inner) return gained;
    int64_t read = 0;
    return covered_sum(&f->surroundings, x, y, z, first, last, laid - first, &nothing_known, &read);
}

// Note that a row of this plane was written, and keep its bricks before.
static void touch_row(Grid *g, const Frame *f, Sweep *s, Slab *slab, int64_t b) {
    const int64_t from[3] = {s->plane, b, s->window[2]}, to[3] = {s->plane + 1, b + 1, s->window[3]};
    int64_t low[3], high[3];
    for (int i = 0; i < 3; i++) {
        low[f->axis[i]] = from[i];
        high[f->axis[i]] = to[i];
    }
    mark_dirty(s->dirty, low[0], high[0], low[1], high[1], low[2], high[2]);
    if (f->stride[2] == 1) {
        keep_box(g, low[0], high[0], low[1], high[1], low[2], high[2]);
        return;
    }
    slab->dirty_a0 = least(slab->dirty_a0, s->plane);
    slab->dirty_a1 = most(slab->dirty_a1, s->plane + 1);
    slab->dirty_b0 = least(slab->dirty_b0, b);
    slab->dirty_b1 = most(slab->dirty_b1, b + 1);
    slab->dirty_c0 = least(slab->dirty_c0, s->window[2]);
    slab->dirty_c1 = most(slab->dirty_c1, s->window[3]);
}

// Whether the map knows that the voxels [b0, b1) x [c0, c1) of this plane are full: all flux goes on, and none is read.
static int surely_full(const Grid *g, const Frame *f, int64_t plane, int64_t b0, int64_t b1, int64_t c0, int64_t c1) {
    if (!g->states) return 0;
    const int64_t nj = (g->shape[1] + BRICK - 1) / BRICK, nk = (g->shape[2] + BRICK - 1) / BRICK;
    const int64_t strides[3] = {nj * nk, nk, 1}, b_stride = strides[f->axis[1]], c_stride = strides[f->axis[2]];
    const uint8_t *states = g->states + plane / BRICK * strides[f->axis[0]];
    for (int64_t b = b0 / BRICK; b * BRICK < b1; b++)
        for (int64_t c = c0 / BRICK; c * BRICK < c1; c++)
            if (states[b * b_stride + c * c_stride] != FULL) return 0;
    return 1;
}

// Fill what room one row has outside the tool. Returns whether any flux is left in it.
static int fill_row(Grid *g, const Frame *f, Sweep *s, Slab *slab, int64_t b, float *row, int64_t readable) {
    const int64_t *w = s->window, n = w[3] - w[2];
    const double x = (double)s->plane - f->centre[0], y = (double)b - f->centre[1];
    float *d = row + w[2], *flux = flux_at(s, b, w[2]);
    s->read += n;
    if (all_full(d, n)) return 1; // saturated: all goes on
    // Beyond the window the flux is 0, and so is what it lays: whole lanes are faster where there is memory to read.
    const int64_t lanes = w[2] + whole_lanes(n) <= readable ? whole_lanes(n) : n;
    deposit(d, flux, lanes, s->row);
    if (fabs(x) < extent(&f->volume, 0) + 0.5) {
        const Span tool = row_span(&f->volume, x, y, f->centre[2], f->n[2]);
        const int64_t low = within(tool.low, w[2], w[3]), high = within(tool.high, low, w[3]);
        memset(s->row + (low - w[2]), 0, (size_t)(high - low) * sizeof(float)); // no room in the tool
    }
    if (any_bits(s->row, lanes)) {
        touch_row(g, f, s, slab, b);
        const double gained = lay_down(d, flux, lanes, s->row);
        s->laid += gained;
        if (fabs(x) < extent(&f->surroundings, 0) + 0.5)
            s->reach_gain += reach_gain(f, x, y, s->row, w[2], w[3], gained);
    }
    return any_bits(flux, lanes) != 0;
}

// Fill what room this plane has. Returns whether any flux is left.
static int fill_plane(Grid *g, const Frame *f, Sweep *s, Slab *slab) {
    const int in_memory = f->stride[2] == 1;
    const int64_t *w = s->window;
    int left = 0;
    if (surely_full(g, f, s->plane, w[0], w[1], w[2], w[3])) return 1;
    if (!in_memory && !slab_holds(slab, w, s->plane)) load_slab(g, f, s, slab, s->plane);
    for (int64_t b = w[0]; b < w[1]; b++) {
        const int64_t start = s->plane * f->stride[0] + b * f->stride[1], voxels = f->n[0] * f->n[1] * f->n[2];
        float *row = in_memory ? g->density + start : slab_row(s, slab, s->plane, b);
        left |= fill_row(g, f, s, slab, b, row, in_memory ? voxels - start : 0);
    }
    return left;
}

// Whether there is more flux than one may send back for being negligible.
static int stands(const Sweep *s) {
    double sum = 0.0;
    for (int64_t b = s->window[0]; b < s->window[1]; b++)
        sum += row_sum(flux_at(s, b, s->window[2]), s->window[3] - s->window[2]);
    return sum > (double)NEGLIGIBLE;
}

static void prefetch_row(const float *d, int64_t low, int64_t high) {
    for (int64_t k = low; k < high; k += CACHE_LINE) __builtin_prefetch(d + k);
}

// Ask for a plane's rows while the flux is still being spread: each is a new place in memory.
static void prefetch_plane(const Grid *g, const Frame *f, const Sweep *s) {
    if (f->stride[2] != 1) return; // those planes are read through the slab
    const int64_t *w = s->window, b0 = most(0, w[0] - 1), b1 = least(f->n[1], w[1] + 1);
    const int64_t c0 = most(0, w[2] - 1), c1 = least(f->n[2], w[3] + 1);
    if (surely_full(g, f, s->plane, b0, b1, c0, c1)) return;
    for (int64_t b = b0; b < b1; b++) prefetch_row(g->density + s->plane * f->stride[0] + b * f->stride[1], c0, c1);
}

// Leap: in full material the flux only spreads, and that is diffusion, so the kernel of one plane with holes of h voxels
// between its taps spreads for h^2 planes at once, on the same voxels.

// Where a leap may carry the flux.
static void leap_window(const Sweep *s, int64_t w[4]) {
    for (int i = 0; i < 2; i++) {
        w[2 * i] = s->window[2 * i] + least(0, s->leap_shift[i] - s->hole);
        w[2 * i + 1] = s->window[2 * i + 1] + most(0, s->leap_shift[i] + s->hole);
    }
}

// Whether the map knows it of planes [first, last): none is read.
static int surely_full_ahead(const Grid *g, const Frame *f, const int64_t w[4], int64_t first, int64_t last) {
    for (int64_t plane = first; plane < last; plane = (plane / BRICK + 1) * BRICK)
        if (!surely_full(g, f, plane, w[0], w[1], w[2], w[3])) return 0;
    return 1;
}

// Whether planes [first, last) are full in a window; asked from the far end, where room is likelier.
static int all_full_ahead(const Grid *g, const Frame *f, const int64_t w[4], int64_t first, int64_t last,
                          int64_t step) {
    if (surely_full_ahead(g, f, w, first, last)) return 1;
    if (f->stride[2] != 1) { // then a row along c is far apart in memory, and the planes are not
        for (int64_t b = w[0]; b < w[1]; b++)
            for (int64_t c = w[2]; c < w[3]; c++) {
                const float *d = g->density + b * f->stride[1] + c * f->stride[2] + first;
                if (c + ROWS_AHEAD < w[3]) prefetch_row(d + ROWS_AHEAD * f->stride[2], 0, last - first);
                if (!all_full(d, last - first)) return 0;
            }
        return 1;
    }
    for (int64_t q = 0; q < last - first; q++) {
        const int64_t plane = step > 0 ? last - 1 - q : first + q;
        for (int64_t b = w[0]; b < w[1]; b++) {
            const float *d = g->density + plane * f->stride[0] + b * f->stride[1] + w[2];
            if (b + ROWS_AHEAD < w[1]) prefetch_row(d + ROWS_AHEAD * f->stride[1], 0, w[3] - w[2]);
            if (!all_full(d, w[3] - w[2])) return 0;
        }
    }
    return 1;
}

// Whether the flux may leap from the plane before this one: far from the tool, through full material inside the grid. A
// band may lie on the way: nothing is laid there, and all that is over it is surplus in the next plane.
static int may_leap(const Grid *g, const Frame *f, const Sweep *s, int64_t step) {
    const int64_t planes = s->hole * s->hole, end = s->plane + step * (planes - 1);
    int64_t w[4];
    if (!planes || (double)step * ((double)s->plane - f->centre[0]) < s->far) return 0;
    leap_window(s, w);
    if (end < 0 || end >= f->n[0] || w[0] < 0 || w[1] > f->n[1] || w[2] < 0 || w[3] > f->n[2]) return 0;
    return all_full_ahead(g, f, w, least(s->plane, end), most(s->plane, end) + 1, step);
}

// flux'(b, c) = sum of w(i, j) flux(b - h i, c - h j): one row from three.
static void leap_row(const float w[9], int64_t h, const float *restrict above, const float *restrict here,
                     const float *restrict below, int64_t n, float *restrict to) {
    for (int64_t k = 0; k < n; k++)
        to[k] = w[0] * above[k + 2 * h] + w[1] * above[k + h] + w[2] * above[k] + w[3] * here[k + 2 * h] +
                w[4] * here[k + h] + w[5] * here[k] + w[6] * below[k + 2 * h] + w[7] * below[k + h] + w[8] * below[k];
}

// The flux on the plane to which it leaps.
static void leap(Sweep *s, int64_t step) {
    const int64_t h = s->hole, *w = s->window, rows = w[1] - w[0], n = w[3] - w[2], stride = n + 4 * h;
    float *framed = s->next; // a copy with as much air around it as the kernel is wide
    memset(framed, 0, (size_t)((rows + 4 * h) * stride) * sizeof(float));
    for (int64_t b = 0; b < rows; b++)
        memcpy(framed + (b + 2 * h) * stride + 2 * h, flux_at(s, w[0] + b, w[2]), (size_t)n * sizeof(float));
    const int64_t reached[4] = {w[0] + s->leap_shift[0] - h, w[1] + s->leap_shift[0] + h, w[2] + s->leap_shift[1] - h,
                                w[3] + s->leap_shift[1] + h};
    lay_buffer(s, s->flux, reached);
    for (int64_t b = 0; b < rows + 2 * h; b++) {
        const float *above = framed + (b + 2 * h) * stride, *here = framed + (b + h) * stride;
        leap_row(s->leap_weights, h, above, here, framed + b * stride, n + 2 * h,
                 flux_at(s, reached[0] + b, reached[2]));
    }
    trim(s);
    s->plane += step * (h * h - 1);
    s->planes++;
    s->visited += (s->window[1] - s->window[0]) * (s->window[3] - s->window[2]);
}

// Carry the emptied mass plane by plane along the dominant axis, from the tool's rear (DESIGN 2, Dispersion).
// Returns DONE, or NEEDS_GROWTH when mass stands at a growing border: then grow the grid, move the indices, call again.
EXPORT int64_t repousse_sweep(Grid *g, const Tool *t, const Emptied *e, Sweep *s) {
    const Frame f = frame_of(g, t, e->axis);
    const int64_t step = s->direction[f.axis[0]] < 0.0 ? -1 : 1;
    const int64_t last_source = step > 0 ? e->last[0] - 1 : e->first[0];
    Slab slab = {0};
    for (;; s->plane += step) {
        const int sources = s->plane >= e->first[0] && s->plane < e->last[0];
        const int sources_ahead = (last_source - s->plane) * step >= 0;
        if (!s->spread_done) {
            if (s->window[0] >= s->window[1] && !sources_ahead) break;
            if (s->plane < 0 || s->plane >= f.n[0]) {
                if (s->border == GROW && stands(s) && ask_growth(s, &f, step < 0, step > 0)) {
                    flush_slab(g, &f, s, &slab);
                    return NEEDS_GROWTH;
                }
                const double left = take_flux(s, s->window[0], s->window[1], s->window[2], s->window[3]);
                if (s->border == OPEN) s->mass_out += left;
                else s->surplus += left;
                break;
            }
            if (s->window[0] >= s->window[1] && !sources) continue;
            if (!sources_ahead && may_leap(g, &f, s, step)) {
                leap(s, step);
                continue;
            }
            prefetch_plane(g, &f, s);
            spread(s, e, sources);
            if (sources) add_sources(s, e);
            trim(s);
            s->spread_done = 1;
        }
        if (s->border == GROW && ask_growth(s, &f, 0, 0)) {
            flush_slab(g, &f, s, &slab);
            return NEEDS_GROWTH;
        }
        apply_border(s, &f);
        s->spread_done = 0;
        s->planes++;
        if (s->window[0] >= s->window[1] || s->window[2] >= s->window[3]) {
            s->window[1] = s->window[0];
            continue;
        }
        s->visited += (s->window[1] - s->window[0]) * (s->window[3] - s->window[2]);
        const int goes_on = s->limit == INFINITY || stop_at_band(s, &f);
        if (!goes_on || !fill_plane(g, &f, s, &slab)) s->window[1] = s->window[0];
    }
    flush_slab(g, &f, s, &slab);
    return DONE;
}

// The rim (core/rim.py, facts/rim.md).

static int64_t cluster_of(double x, double side) {
    const int64_t steps = floor_of(fabs(x) / side + 0.5), middle = CLUSTERS / 2;
    return within(x < 0.0 ? middle - steps : middle + steps, 0, CLUSTERS - 1);
}

// Cluster the emptied material into points a part of its radius apart, which is less than the tool's where that is not
// wholly emptied, and measure a = sqrt(2 variance across u), the radius of a disc that
// spreads as far.
EXPORT void repousse_rim_sources(const Grid *g, const Tool *t, const Emptied *e, const double u[3], Sources *out) {
    double bins[MAX_POINTS][4], mass = 0.0, mean[3] = {0.0, 0.0, 0.0}, second = 0.0;
    const Frame f = frame_of(g, t, e->axis);
    double radius = CLUSTERS_IN_RADIUS; // of what was emptied, about the tool's centre
    for (int i = 0; i < 3; i++)
        radius = fmax(radius, fmax(f.centre[i] - (double)e->first[i], (double)(e->last[i] - 1) - f.centre[i]));
    const double side = radius / CLUSTERS_IN_RADIUS;
    memset(bins, 0, sizeof bins);
    for (int64_t a = e->first[0]; a < e->last[0]; a++)
        for (int64_t b = e->first[1]; b < e->last[1]; b++)
            for (int64_t c = e->first[2]; c < e->last[2]; c++) {
                const double m = (double)*emptied_at(e, a, b, c);
                if (m <= 0.0) continue;
                double at[3], along = 0.0;
                at[f.axis[0]] = (double)a - f.centre[0];
                at[f.axis[1]] = (double)b - f.centre[1];
                at[f.axis[2]] = (double)c - f.centre[2];
                double *bin = bins[(cluster_of(at[0], side) * CLUSTERS + cluster_of(at[1], side)) * CLUSTERS +
                                   cluster_of(at[2], side)];
                bin[0] += m;
                for (int i = 0; i < 3; i++) {
                    bin[1 + i] += m * at[i];
                    along += at[i] * u[i];
                }
                mass += m;
                for (int i = 0; i < 3; i++) {
                    const double across = at[i] - along * u[i];
                    mean[i] += m * across;
                    second += m * across * across;
                }
            }
    out->count = 0;
    for (int64_t i = 0; i < MAX_POINTS; i++) {
        if (bins[i][0] <= 0.0) continue;
        out->mass[out->count] = bins[i][0];
        out->x[out->count] = t->centre[0] + bins[i][1] / bins[i][0];
        out->y[out->count] = t->centre[1] + bins[i][2] / bins[i][0];
        out->z[out->count++] = t->centre[2] + bins[i][3] / bins[i][0];
    }
    const double spread2 =
        mass > 0.0 ? second / mass - (mean[0] * mean[0] + mean[1] * mean[1] + mean[2] * mean[2]) / (mass * mass) : 0.0;
    out->contact_radius = sqrt(fmax(2.0 * spread2, 0.0));
}

typedef struct { // positions relative to their mean
    float x[MAX_POINTS + LANES], y[MAX_POINTS + LANES], z[MAX_POINTS + LANES], mass[MAX_POINTS + LANES];
    int64_t padded;
    double centre[3], low[3], high[3], total;
} Points;

static Points points_of(const Sources *s) {
    Points p = {.padded = whole_lanes(s->count)};
    for (int i = 0; i < 3; i++) {
        p.low[i] = INFINITY;
        p.high[i] = -INFINITY;
        p.centre[i] = 0.0;
    }
    for (int64_t q = 0; q < s->count; q++) {
        const double at[3] = {s->x[q], s->y[q], s->z[q]};
        p.total += s->mass[q];
        for (int i = 0; i < 3; i++) {
            p.centre[i] += s->mass[q] * at[i];
            p.low[i] = fmin(p.low[i], at[i]);
            p.high[i] = fmax(p.high[i], at[i]);
        }
    }
    for (int i = 0; i < 3; i++) p.centre[i] /= p.total;
    for (int64_t q = 0; q < s->count; q++) {
        p.x[q] = (float)(s->x[q] - p.centre[0]);
        p.y[q] = (float)(s->y[q] - p.centre[1]);
        p.z[q] = (float)(s->z[q] - p.centre[2]);
        p.mass[q] = (float)s->mass[q];
    }
    return p;
}

static float density_at(const Grid *g, int64_t i, int64_t j, int64_t k) {
    if (i < 0 || j < 0 || k < 0 || i >= g->shape[0] || j >= g->shape[1] || k >= g->shape[2]) return 0.0f;
    return g->density[(i * g->shape[1] + j) * g->shape[2] + k];
}

// Distance to a shape, or something beyond NEAR where that needs no square root.
static double distance_near(const Shape *s, double x, double y, double z) {
    if (fabs(x) > extent(s, 0) + NEAR || fabs(y) > extent(s, 1) + NEAR || fabs(z) > extent(s, 2) + NEAR)
        return 2.0 * NEAR;
    return distance(s, x, y, z);
}

static double covered(const Shape *s, double x, double y, double z) { return coverage_at(distance_near(s, x, y, z)); }

// A voxel in one number that sorts as its index does, and is taken apart without dividing.
#define PLACE_BITS 19
#define PLACE_MASK ((1 << PLACE_BITS) - 1)
static int64_t place_of(int64_t i, int64_t j, int64_t k) { return (i << PLACE_BITS | j) << PLACE_BITS | k; }
static void take_apart(int64_t place, int64_t at[3]) {
    at[0] = place >> 2 * PLACE_BITS;
    at[1] = place >> PLACE_BITS & PLACE_MASK;
    at[2] = place & PLACE_MASK;
}

static const int64_t neighbours[6][3] = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};

// Room that the tool leaves in a voxel, cap = 1 - w; 1 far from it.
static double capacity(const Tool *t, int64_t i, int64_t j, int64_t k) {
    return 1.0 - covered(&t->volume, (double)i - t->centre[0], (double)j - t->centre[1], (double)k - t->centre[2]);
}

// How far material has come up in a voxel that carries the next one: 0 below RISING, 1 from RISEN on.
static float risen(float d) { return d <= RISING ? 0.0f : d >= RISEN ? 1.0f : (d - RISING) / (RISEN - RISING); }

static int full_at(const Grid *g, const Tool *t, int near, int64_t i, int64_t j, int64_t k) {
    const double cap = near ? capacity(t, i, j, k) : 1.0;
    return cap >= 0.5 && (double)density_at(g, i, j, k) >= cap - (double)NEARLY_FULL;
}

static float share_of(int on_full, float here, float carried) {
    return on_full ? 1.0f - 0.5f * risen(here) : 0.5f * carried;
}

// `support` where neither the tool nor the grid's end is near.
static float support_inside(const float *d, const int64_t stride[3]) {
    const float enough = 1.0f - NEARLY_FULL;
    float carried = 0.0f;
    for (int a = 0; a < 3; a++)
        for (int64_t step = -stride[a]; step <= stride[a]; step += 2 * stride[a]) {
            if (d[step] >= enough) return share_of(1, *d, 0.0f);
            if (d[step] > RISING && d[2 * step] >= enough) carried = fmaxf(carried, risen(d[step]));
        }
    return share_of(0, *d, carried);
}

// Share of what comes up here that this voxel takes. On full material it takes all, and half once it carries the next
// voxel, which takes the other half: a surface that rises is two voxels thick, and no step shows (core/rim.py).
static float support(const Grid *g, const Tool *t, int near, int64_t i, int64_t j, int64_t k) {
    const int64_t *n = g->shape, stride[3] = {n[1] * n[2], n[2], 1};
    if (!near && i > 1 && j > 1 && k > 1 && i + 2 < n[0] && j + 2 < n[1] && k + 2 < n[2])
        return support_inside(g->density + i * stride[0] + j * stride[1] + k, stride);
    float carried = 0.0f;
    for (int q = 0; q < 6; q++) {
        const int64_t *to = neighbours[q], x = i + to[0], y = j + to[1], z = k + to[2];
        if (full_at(g, t, near, x, y, z)) return share_of(1, density_at(g, i, j, k), 0.0f);
        const float carries = risen(density_at(g, x, y, z));
        if (carries > carried && full_at(g, t, near, x + to[0], y + to[1], z + to[2])) carried = carries;
    }
    return share_of(0, 0.0f, carried);
}

// Signed distance to all that the tool has gone through on the last `wake` voxels of its way.
static double swept_distance(const Tool *t, const Rim *r, double x, double y, double z) {
    const double *u = r->direction, behind = clamp(-(x * u[0] + y * u[1] + z * u[2]), 0.0, r->wake);
    return distance(&t->volume, x + behind * u[0], y + behind * u[1], z + behind * u[2]);
}

// The tool's wake: where it came from. Nothing falls in there.
static int in_wake(const Tool *t, const Rim *r, double x, double y, double z) {
    const double *u = r->direction;
    return x * u[0] + y * u[1] + z * u[2] < 0.0 && r->wake > 0.0 && swept_distance(t, r, x, y, z) < 0.5;
}

static int inside_grid(const Grid *g, const double at[3]) {
    for (int a = 0; a < 3; a++)
        if (at[a] < 0.0 || at[a] > (double)(g->shape[a] - 1)) return 0;
    return 1;
}

// Whether material joins a cell of the surface to the sources: the line from just inside it must not cross air. The
// tool and its wake count as material: it flows around them.
static int joined(const Grid *g, const Tool *t, Rim *r, const double to[3], const Cell *cell) {
    double from[3], way[3], length2 = 0.0;
    const double *in = cell->inward, norm = fmax(sqrt(in[0] * in[0] + in[1] * in[1] + in[2] * in[2]), 1e-6);
    for (int a = 0; a < 3; a++) {
        from[a] = cell->at[a] / (double)cell->count + SIGHT_INSET * in[a] / norm;
        way[a] = to[a] - from[a];
        length2 += way[a] * way[a];
    }
    const double length = sqrt(length2), step = fmax(SIGHT_STEP, length / SIGHT_SAMPLES);
    const int64_t samples = (int64_t)(length / step);
    const int surely_inside = inside_grid(g, from) && inside_grid(g, to); // then so is all between them
    const double part = step / length, dx = way[0] * part, dy = way[1] * part, dz = way[2] * part;
    for (int64_t q = 0; q < samples; q++) {
        const double x = from[0] + (double)q * dx, y = from[1] + (double)q * dy, z = from[2] + (double)q * dz;
        const float d =
            surely_inside
                ? g->density[((int64_t)(x + 0.5) * g->shape[1] + (int64_t)(y + 0.5)) * g->shape[2] + (int64_t)(z + 0.5)]
                : density_at(g, floor_of(x + 0.5), floor_of(y + 0.5), floor_of(z + 0.5));
        r->sights++;
        if (d < SIGHT_AIR && swept_distance(t, r, x - t->centre[0], y - t->centre[1], z - t->centre[2]) > 1.0) return 0;
    }
    return 1;
}

// A row and those beside it, one and two voxels away; the other neighbours are in the row itself.
typedef struct {
    const float *row, *beside[4], *second[4];
} Rows;

static Rows rows_around(const Grid *g, const Rim *r, int64_t i, int64_t j) {
    const int64_t n = g->shape[2], step[2] = {g->shape[1] * n, n}, at[2] = {i, j};
    Rows rows = {.row = g->density + i * step[0] + j * n};
    for (int q = 0; q < 4; q++) {
        const int64_t a = q / 2, way = q % 2 ? -1 : 1, one = at[a] + way, two = one + way;
        rows.beside[q] = one >= 0 && one < g->shape[a] ? rows.row + way * step[a] : r->zeros;
        rows.second[q] = two >= 0 && two < g->shape[a] ? rows.row + 2 * way * step[a] : r->zeros;
    }
    return rows;
}

// At least `enough` where a neighbour is, or where it carries (d > RISING) and the one behind it is.
static void strongest(const float *restrict one, const float *restrict two, float enough, float *restrict most_) {
    const float lift = enough - RISING;
    for (int k = 0; k < LANES; k++) {
        const float behind = one[k] + lift < two[k] ? one[k] + lift : two[k];
        const float here = one[k] > behind ? one[k] : behind;
        most_[k] = here > most_[k] ? here : most_[k];
    }
}

// Mark which of LANES voxels, none at the row's ends, are not full and have such a neighbour; whether any is.
static int mark(const Rows *rows, float enough, int64_t first, uint8_t *restrict marks) {
    const float *d = rows->row + first, full = 1.0f - NEARLY_FULL;
    float found[LANES] = {0.0f};
    int any = 0;
    for (int k = 0; k < LANES; k++) any |= d[k] < full;
    if (!any) return 0;
    any = 0;
    strongest(d - 1, d - 2, enough, found);
    strongest(d + 1, d + 2, enough, found);
    for (int q = 0; q < 4; q++) strongest(rows->beside[q] + first, rows->second[q] + first, enough, found);
    for (int k = 0; k < LANES; k++) any |= (found[k] >= enough) & (d[k] < full);
    if (any)
        for (int k = 0; k < LANES; k++) marks[k] = (uint8_t)((found[k] >= enough) & (d[k] < full));
    return any;
}

// Whether a voxel at the grid's end has a neighbour that may be full or carry: the exact test decides.
static uint8_t mark_at_end(const Rows *rows, int64_t k, int64_t n) {
    float found = fmaxf(k > 0 ? rows->row[k - 1] : 0.0f, k + 1 < n ? rows->row[k + 1] : 0.0f);
    for (int q = 0; q < 4; q++) found = fmaxf(found, rows->beside[q][k]);
    return found > RISING;
}

// Nothing to mark where all is full, or where all is air.
static int dull(const Rows *rows, int64_t k) {
    if (rows->row[k] > 0.0f) return all_full(rows->row + k, STRETCH);
    uint32_t bits = any_bits(rows->row + k - 1, STRETCH + 2);
    for (int q = 0; q < 4 && !bits; q++) bits |= any_bits(rows->beside[q] + k, STRETCH);
    return bits == 0;
}

// Where in a row a voxel may be beside the tool: there it is full when it fills what the tool leaves of it.
static Span near_tool(const Tool *t, int64_t i, int64_t j) {
    if (fabs((double)i - t->centre[0]) > extent(&t->volume, 0) + NEAR ||
        fabs((double)j - t->centre[1]) > extent(&t->volume, 1) + NEAR)
        return no_span;
    return (Span){floor_of(t->centre[2] - extent(&t->volume, 2) - NEAR),
                  ceil_of(t->centre[2] + extent(&t->volume, 2) + NEAR) + 1};
}

// W = sum over the sources of e max(0, 1 - |x - x_s| / L), less FAINT of all, on nodes around the tool's centre. It
// bends little within a node's distance, so between nodes it is interpolated.
typedef struct {
    double low[3], spacing; // position of the first node
    int64_t n[3];
    float *value;
} Lattice;

static Lattice lattice_around(const Points *p, const Tool *t, double length, float *value) {
    Lattice w = {.spacing = length / NODES_IN_HAT, .value = value};
    for (int a = 0; a < 3; a++)
        w.spacing = fmax(w.spacing, (p->high[a] - p->low[a] + 2.0 * length) / (double)(LATTICE - 3));
    for (int a = 0; a < 3; a++) {
        const int64_t first = floor_of((p->low[a] - length - t->centre[a]) / w.spacing);
        w.n[a] = ceil_of((p->high[a] + length - t->centre[a]) / w.spacing) - first + 1;
        w.low[a] = t->centre[a] + (double)first * w.spacing;
    }
    return w;
}

// Distance along one axis to the box around the sources.
static double beyond_box(const Points *p, int a, double x) { return fmax(fmax(p->low[a] - x, x - p->high[a]), 0.0); }

static void sum_hats(const Points *p, double length, Lattice *w, Rim *r) {
    const float inverse = (float)(1.0 / length), faint = (float)(FAINT * p->total);
    float across2[MAX_POINTS + LANES];
    for (int64_t a = 0; a < w->n[0]; a++)
        for (int64_t b = 0; b < w->n[1]; b++) {
            const double at[2] = {w->low[0] + (double)a * w->spacing, w->low[1] + (double)b * w->spacing};
            const double far_x = beyond_box(p, 0, at[0]), far_y = beyond_box(p, 1, at[1]);
            const float x = (float)(at[0] - p->centre[0]), y = (float)(at[1] - p->centre[1]);
            float *row = w->value + (a * w->n[1] + b) * w->n[2];
            for (int64_t q = 0; q < p->padded; q++) {
                const float dx = x - p->x[q], dy = y - p->y[q];
                across2[q] = dx * dx + dy * dy;
            }
            for (int64_t c = 0; c < w->n[2]; c++) {
                const double at_c = w->low[2] + (double)c * w->spacing, far_z = beyond_box(p, 2, at_c);
                const float z = (float)(at_c - p->centre[2]);
                float lanes[LANES] = {0.0f}, sum = 0.0f;
                row[c] = -faint;
                if (far_x * far_x + far_y * far_y + far_z * far_z >= length * length) continue;
                r->hats += p->padded;
                for (int64_t q = 0; q < p->padded; q += LANES)
                    for (int l = 0; l < LANES; l++) {
                        const float dz = z - p->z[q + l];
                        const float hat = 1.0f - sqrtf(across2[q + l] + dz * dz) * inverse;
                        lanes[l] += p->mass[q + l] * (hat > 0.0f ? hat : 0.0f);
                    }
                for (int l = 0; l < LANES; l++) sum += lanes[l];
                row[c] += sum;
            }
        }
}

static int64_t cell_in_lattice(const Lattice *w, int a, double x) {
    return within(floor_of((x - w->low[a]) / w->spacing), 0, w->n[a] - 2);
}

// The voxels of a row, n long, in column (a, b) of the lattice, between nodes of which any is above 0.
static Span row_of_hats(const Lattice *w, int64_t a, int64_t b, int64_t n) {
    const int64_t row = w->n[2];
    int64_t first = row, last = -1;
    for (int q = 0; q < 4; q++) {
        const float *v = w->value + ((a + q / 2) * w->n[1] + b + q % 2) * row;
        for (int64_t c = 0; c < row; c++)
            if (v[c] > 0.0f) {
                first = least(first, c);
                last = most(last, c);
            }
    }
    if (last < 0) return no_span;
    const double low = w->low[2] + (double)(first - 1) * w->spacing, high = w->low[2] + (double)(last + 1) * w->spacing;
    const int64_t begin = ceil_of(clamp(low, 0.0, (double)n));
    return (Span){begin, most(begin, floor_of(clamp(high, -1.0, (double)(n - 1))) + 1)};
}

static double between(double part, double first, double second) { return first + part * (second - first); }

static float hats_at(const Lattice *w, int64_t i, int64_t j, int64_t k) {
    const double x[3] = {(double)i, (double)j, (double)k};
    int64_t cell[3];
    double part[3], along[4];
    for (int a = 0; a < 3; a++) {
        cell[a] = cell_in_lattice(w, a, x[a]);
        part[a] = (x[a] - w->low[a]) / w->spacing - (double)cell[a];
    }
    for (int q = 0; q < 4; q++) {
        const float *v = w->value + ((cell[0] + q / 2) * w->n[1] + cell[1] + q % 2) * w->n[2] + cell[2];
        along[q] = between(part[2], (double)v[0], (double)v[1]);
    }
    return (float)between(part[0], between(part[1], along[0], along[1]), between(part[1], along[2], along[3]));
}

// Weight of one voxel = W x support, or 0 where material cannot rise.
static float rise_weight(const Grid *g, const Tool *t, const Lattice *w, Rim *r, int64_t i, int64_t j, int64_t k) {
    const double x = (double)i - t->centre[0], y = (double)j - t->centre[1], z = (double)k - t->centre[2];
    const double far = distance_near(&t->volume, x, y, z),
                 room = 1.0 - coverage_at(far) - (double)density_at(g, i, j, k);
    r->asked++;
    if (room <= (double)NEARLY_FULL) return 0.0f;
    const float carried = support(g, t, far < NEAR, i, j, k);
    if (carried <= 0.0f || in_wake(t, r, x, y, z)) return 0.0f;
    return hats_at(w, i, j, k) * carried * (float)fmin(room / LITTLE_ROOM, 1.0);
}

// Number of a cell of the surface along one axis, from the tool's centre: symmetric at ties.
static int64_t surface_cell(double x) {
    const int64_t steps = floor_of(fabs(x) / SIGHT_CELL + 0.5);
    return x < 0.0 ? -steps : steps;
}

static int64_t first_cell(const Tool *t, int a) { return surface_cell(-t->centre[a]); }

// Difference of the densities on both sides of a voxel, along each axis.
static void add_inward(const Grid *g, const int64_t at[3], double inward[3]) {
    const int64_t *n = g->shape, stride[3] = {n[1] * n[2], n[2], 1};
    const float *d = g->density + at[0] * stride[0] + at[1] * stride[1] + at[2];
    for (int a = 0; a < 3; a++) {
        const float up = at[a] + 1 < n[a] ? d[stride[a]] : 0.0f, down = at[a] > 0 ? d[-stride[a]] : 0.0f;
        inward[a] += (double)up - (double)down;
    }
}

// Of the listed voxels from `first` on, all in one layer of cells, keep those whose cell is joined to the sources.
static void keep_joined(const Grid *g, const Tool *t, Rim *r, const double to[3], int64_t first) {
    const int64_t columns = surface_cell((double)(g->shape[2] - 1) - t->centre[2]) - first_cell(t, 2) + 1;
    const int64_t origin = first_cell(t, 1) * columns + first_cell(t, 2);
    int64_t kept = first, at[3];
    for (int64_t q = first; q < r->count; q++) {
        take_apart(r->index[q], at);
        r->spill_index[q] =
            surface_cell((double)at[1] - t->centre[1]) * columns + surface_cell((double)at[2] - t->centre[2]) - origin;
        Cell *cell = r->cells + r->spill_index[q];
        cell->count++;
        for (int a = 0; a < 3; a++) cell->at[a] += (double)at[a];
        add_inward(g, at, cell->inward);
    }
    for (int64_t q = first; q < r->count; q++) {
        Cell *cell = r->cells + r->spill_index[q];
        if (!cell->joined) cell->joined = joined(g, t, r, to, cell) ? JOINED : APART;
    }
    const int64_t last = r->count;
    for (int64_t q = first; q < last; q++) {
        if (r->cells[r->spill_index[q]].joined != JOINED) continue;
        r->index[kept] = r->index[q];
        r->weight[kept++] = r->weight[q];
    }
    r->count = kept;
    for (int64_t q = first; q < last; q++) memset(r->cells + r->spill_index[q], 0, sizeof(Cell));
}

static int64_t list_voxel(Rim *r, int64_t place, float weight) {
    if (weight <= 0.0f) return DONE;
    if (r->count == r->capacity) return LIST_FULL;
    r->index[r->count] = place;
    r->weight[r->count++] = weight;
    return DONE;
}

static int64_t gather_row(const Grid *g, const Tool *t, const Lattice *w, Rim *r, int64_t i, int64_t j, Span row) {
    const int64_t n = g->shape[2];
    const Span beside_tool = near_tool(t, i, j);
    const Rows rows = rows_around(g, r, i, j);
    if (i + 2 < g->shape[0] && j + 3 < g->shape[1]) prefetch_row(rows.second[0] + 3 * n, row.low, row.high);
    for (int64_t k = row.low; k < row.high;) {
        if (k > 1 && k + STRETCH + 1 < n && dull(&rows, k)) {
            k += STRETCH;
            continue;
        }
        const int64_t begin = k, end = least(k + LANES, row.high);
        const float enough = k < beside_tool.high && end > beside_tool.low ? 0.49f : 1.0f - NEARLY_FULL;
        uint8_t marks[LANES];
        if (k < 2 || k + LANES + 1 >= n)
            for (int64_t q = k; q < end; q++) marks[q - k] = mark_at_end(&rows, q, n);
        else if (!mark(&rows, enough, k, marks)) {
            k = end;
            continue;
        }
        for (; k < end; k++)
            if (marks[k - begin] && list_voxel(r, place_of(i, j, k), rise_weight(g, t, w, r, i, j, k)) == LIST_FULL)
                return LIST_FULL;
    }
    return DONE;
}

// Collect the free surface around the contact: each voxel that may be part of it is asked for its weight.
EXPORT int64_t repousse_rim_gather(const Grid *g, const Tool *t, const Sources *s, double length, Rim *r) {
    const Points p = points_of(s);
    Lattice w = lattice_around(&p, t, length, r->lattice);
    int64_t low[2], high[2], layer = 0;
    sum_hats(&p, length, &w, r);
    r->count = 0;
    for (int a = 0; a < 2; a++) {
        low[a] = most(0, ceil_of(clamp(p.low[a] - length, 0.0, (double)g->shape[a])));
        high[a] = least(g->shape[a], floor_of(clamp(p.high[a] + length, -1.0, (double)g->shape[a])) + 1);
    }
    for (int64_t i = low[0]; i < high[0]; i++) {
        int64_t column = -1;
        Span row = no_span;
        for (int64_t j = low[1]; j < high[1]; j++) {
            const int64_t b = cell_in_lattice(&w, 1, (double)j);
            if (b != column) row = row_of_hats(&w, cell_in_lattice(&w, 0, (double)i), b, g->shape[2]);
            column = b;
            if (row.high > row.low && gather_row(g, t, &w, r, i, j, row) == LIST_FULL) return LIST_FULL;
        }
        const double x = (double)i - t->centre[0];
        if (i + 1 < high[0] && surface_cell(x) == surface_cell(x + 1.0)) continue;
        keep_joined(g, t, r, p.centre, layer);
        layer = r->count;
    }
    return DONE;
}

static double room_at(const Grid *g, const Tool *t, int64_t i, int64_t j, int64_t k) {
    return capacity(t, i, j, k) - (double)density_at(g, i, j, k);
}

// A bit for each of the six neighbours, inside the grid and outside the wake, that has room.
static int64_t open_neighbours(const Grid *g, const Tool *t, const Rim *r, int64_t i, int64_t j, int64_t k) {
    int64_t bits = 0;
    for (int n = 0; n < 6; n++) {
        const int64_t x = i + neighbours[n][0], y = j + neighbours[n][1], z = k + neighbours[n][2];
        const int outside = x < 0 || y < 0 || z < 0 || x >= g->shape[0] || y >= g->shape[1] || z >= g->shape[2];
        if (!outside && room_at(g, t, x, y, z) > (double)NEARLY_FULL &&
            !in_wake(t, r, (double)x - t->centre[0], (double)y - t->centre[1], (double)z - t->centre[2]))
            bits |= 1 << n;
    }
    return bits;
}

// Raise a voxel; returns what it gained, rounding included.
static double raise_voxel(Grid *g, const Tool *t, Rim *r, int64_t i, int64_t j, int64_t k, double amount) {
    float *d = g->density + (i * g->shape[1] + j) * g->shape[2] + k;
    const double former = (double)*d;
    keep_box(g, i, i + 1, j, j + 1, k, k + 1);
    mark_dirty(r->dirty, i, i + 1, j, j + 1, k, k + 1);
    *d = (float)(former + amount);
    const double x = (double)i - t->centre[0], y = (double)j - t->centre[1], z = (double)k - t->centre[2];
    const double gained = (double)*d - former, inside = covered(&t->volume, x, y, z);
    r->tool_gain += inside * gained;
    r->reach_gain += (covered(&t->surroundings, x, y, z) - inside) * gained;
    return gained;
}

// What voxels of the list could not hold goes in equal shares to their neighbours with room. Returns what is left.
static double spill_over(Grid *g, const Tool *t, Rim *r) {
    double left = 0.0;
    int64_t at[3];
    for (int64_t q = 0; q < r->spilling; q++) { // choose all before moving any
        take_apart(r->spill_index[q], at);
        r->spill_index[q] = r->spill_index[q] << 6 | open_neighbours(g, t, r, at[0], at[1], at[2]);
    }
    for (int64_t q = 0; q < r->spilling; q++) {
        const int64_t open = r->spill_index[q] & 63;
        int ways = 0;
        take_apart(r->spill_index[q] >> 6, at);
        left += (double)r->spill[q];
        for (int n = 0; n < 6; n++) ways += open >> n & 1;
        for (int n = 0; n < 6; n++) {
            if (!(open >> n & 1)) continue;
            const int64_t x = at[0] + neighbours[n][0], y = at[1] + neighbours[n][1], z = at[2] + neighbours[n][2];
            left -= raise_voxel(g, t, r, x, y, z, fmin((double)r->spill[q] / ways, fmax(room_at(g, t, x, y, z), 0.0)));
        }
    }
    return left;
}

// Lay `amount` on the gathered surface by weight. What a voxel cannot hold goes over to its neighbours once; what then
// is left is laid on the voxels of the list that still have room. Returns what is left of that.
EXPORT double repousse_rim_place(Grid *g, const Tool *t, Rim *r, double amount) {
    double left = amount;
    int64_t at[3];
    for (int round = 0; round < PLACINGS && left > ENOUGH * amount; round++) {
        double total = 0.0;
        for (int64_t q = 0; q < r->count; q++) {
            take_apart(r->index[q], at);
            if (room_at(g, t, at[0], at[1], at[2]) <= (double)NEARLY_FULL) r->weight[q] = 0.0f;
            total += (double)r->weight[q];
        }
        if (total <= 0.0) break;
        const double each = left / total;
        r->spilling = 0;
        for (int64_t q = 0; q < r->count; q++) {
            if (r->weight[q] <= 0.0f) continue;
            take_apart(r->index[q], at);
            const double share = each * (double)r->weight[q], room = fmax(room_at(g, t, at[0], at[1], at[2]), 0.0);
            left -= raise_voxel(g, t, r, at[0], at[1], at[2], fmin(share, room));
            if (share <= room || round > 0) continue;
            r->spill_index[r->spilling] = r->index[q];
            r->spill[r->spilling++] = (float)(share - room);
            left -= (double)r->spill[r->spilling - 1];
        }
        left += spill_over(g, t, r);
    }
    return left;
}

// Smooth (core/smooth.py).

// What one neighbour brings: nothing where the two are as good as equal, or a trace of density would creep into the air.
static float brought(float weight, float there, float here) {
    const float more = there - here;
    return fabsf(more) > NEGLIGIBLE ? weight * more : 0.0f;
}

// A stretch of a row after one exchange of each voxel with its six neighbours. Opposite ones are added first, so that
// mirror images are the same to the last bit.
static void exchange(float *restrict d, const float *restrict former, const float *restrict w, int64_t n, int64_t plane,
                     int64_t row, float share) {
    for (int64_t k = 0; k < n; k++) {
        const float here = former[k];
        const float x = brought(w[k - plane], former[k - plane], here) + brought(w[k + plane], former[k + plane], here);
        const float y = brought(w[k - row], former[k - row], here) + brought(w[k + row], former[k + row], here);
        const float z = brought(w[k - 1], former[k - 1], here) + brought(w[k + 1], former[k + 1], here);
        d[k] = here + share * w[k] * ((x + y) + z);
    }
}

static double row_change(const float *v, const float *former, int64_t n) {
    double lanes[LANES] = {0.0};
    int64_t k = 0;
    for (; k + LANES <= n; k += LANES)
        for (int l = 0; l < LANES; l++) lanes[l] += (double)fabsf(v[k + l] - former[k + l]);
    for (; k < n; k++) lanes[0] += (double)fabsf(v[k] - former[k]);
    return lane_sum(lanes);
}

// Passes of diffusion inside the tool: neighbours with coverages v, w exchange `share` v w of their difference, so no
// mass is made or lost, and none crosses the tool's skin or the grid's border. The box of `e` is in grid order; its
// buffer and its list are scratch, zero again when this returns. Returns the mass that was exchanged.
EXPORT double repousse_smooth(Grid *g, const Tool *t, double share, int64_t passes, Emptied *e, int64_t dirty[6]) {
    const int64_t row = e->n[2], plane = e->n[1] * row;
    float *former = e->buffer, *weights = (float *)e->occupied;
    int64_t low[3], high[3];
    double exchanged = 0.0;
    memset(weights, 0, (size_t)(e->n[0] * plane) * sizeof(float));
    for (int a = 0; a < 3; a++) {
        low[a] = within(e->low[a], 0, g->shape[a]);
        high[a] = within(e->low[a] + e->n[a], 0, g->shape[a]);
    }
    for (int64_t pass = -1; pass < passes; pass++) { // before the first the tool is weighed, and before-images kept
        for (int64_t i = low[0]; pass >= 0 && i < high[0]; i++)
            for (int64_t j = low[1]; j < high[1]; j++)
                memcpy(former + (i - e->low[0]) * plane + (j - e->low[1]) * row + (low[2] - e->low[2]),
                       g->density + (i * g->shape[1] + j) * g->shape[2] + low[2],
                       (size_t)most(0, high[2] - low[2]) * sizeof(float));
        for (int64_t i = low[0]; i < high[0]; i++)
            for (int64_t j = low[1]; j < high[1]; j++) {
                const double x = (double)i - t->centre[0], y = (double)j - t->centre[1], z = t->centre[2];
                const Span span = row_span(&t->volume, x, y, z, g->shape[2]);
                if (span.low >= span.high) continue;
                const int64_t at = (i - e->low[0]) * plane + (j - e->low[1]) * row - e->low[2];
                if (pass < 0) {
                    for (int64_t k = span.low; k < span.high; k++)
                        weights[at + k] = (float)coverage(&t->volume, x, y, (double)k - z);
                    keep_box(g, i, i + 1, j, j + 1, span.low, span.high);
                    continue;
                }
                float *d = g->density + (i * g->shape[1] + j) * g->shape[2] + span.low;
                const int64_t n = span.high - span.low;
                exchange(d, former + at + span.low, weights + at + span.low, n, plane, row, (float)share);
                const double changed = row_change(d, former + at + span.low, n);
                if (changed > 0.0) mark_dirty(dirty, i, i + 1, j, j + 1, span.low, span.high);
                exchanged += changed / 2.0;
            }
    }
    memset(former, 0, (size_t)(e->n[0] * plane) * sizeof(float));
    return exchanged;
}

// The paper's recursion, literally (core/recursion.py).

typedef struct {
    const int64_t *voxels; // the tool's voxels, innermost first
    int64_t count;
    int64_t offsets[78];
    double weights[26];
    int64_t forward, wall, budget, calls;
    double kappa, relaxed, smallest, emptied, mass_out, aside;
} Recursion;

// M_t and M_s follow what one voxel gained.
static void account(const Tool *t, Estimate *m, int64_t i, int64_t j, int64_t k, double gained) {
    const double x = (double)i - t->centre[0], y = (double)j - t->centre[1], z = (double)k - t->centre[2];
    const double inside = coverage(&t->volume, x, y, z);
    m->tool_mass += inside * gained;
    m->reach_mass += (coverage(&t->surroundings, x, y, z) - inside) * gained;
}

static void pass_on(Grid *g, const Tool *t, Estimate *m, Recursion *r, int64_t i, int64_t j, int64_t k, double amount) {
    r->calls++;
    for (int64_t q = 0; q < r->forward && r->calls <= r->budget; q++) {
        const double share = amount * r->weights[q];
        const int64_t x = i + r->offsets[3 * q], y = j + r->offsets[3 * q + 1], z = k + r->offsets[3 * q + 2];
        if (x < 0 || y < 0 || z < 0 || x >= g->shape[0] || y >= g->shape[1] || z >= g->shape[2]) {
            if (r->wall) r->aside += share;
            else r->mass_out += share;
            continue;
        }
        float *d = g->density + (x * g->shape[1] + y) * g->shape[2] + z;
        const double former = (double)*d;
        *d = (float)(former + fmin(share, 1.0 - former));
        const double taken = (double)*d - former;
        account(t, m, x, y, z, taken);
        if (share - taken > r->smallest) pass_on(g, t, m, r, x, y, z, share - taken);
        else r->aside += share - taken;
    }
}

EXPORT void repousse_recursive(Grid *g, const Tool *t, Estimate *m, Recursion *r) {
    for (int64_t q = 0; q < r->count && r->calls <= r->budget; q++) {
        if (!(m->tool_mass > r->kappa * m->reach_mass * (1.0 + r->relaxed))) break;
        float *d = g->density + r->voxels[q];
        int64_t at[3];
        voxel_at(g, r->voxels[q], at);
        const double w = coverage(&t->volume, (double)at[0] - t->centre[0], (double)at[1] - t->centre[1],
                                  (double)at[2] - t->centre[2]);
        const double former = (double)*d;
        *d = (float)(former - w * former);
        const double taken = former - (double)*d;
        account(t, m, at[0], at[1], at[2], -taken);
        r->emptied += taken;
        pass_on(g, t, m, r, at[0], at[1], at[2], taken);
    }
}

// The version and the sizes of all structures: core/native/structures.py computes the same, or does not call.
EXPORT int64_t repousse_abi(void) {
    const size_t sizes = sizeof(Shape) + 3 * sizeof(Tool) + 5 * sizeof(Grid) + 7 * sizeof(Estimate) +
                         11 * sizeof(Emptied) + 13 * sizeof(Sweep) + 17 * sizeof(Sources) + 19 * sizeof(Rim) +
                         23 * sizeof(Recursion);
    return ABI_VERSION + 100 * (int64_t)sizes;
}
