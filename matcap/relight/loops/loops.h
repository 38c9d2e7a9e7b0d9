/* Shared by the loops of relighting: pixels, the height field, lobes.

   library.py declares these structures for Python, field by field. */

#ifndef MATCAP_RELIGHT_LOOPS_H
#define MATCAP_RELIGHT_LOOPS_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>

#if defined(__x86_64__) && defined(__linux__) && defined(__GNUC__) && !defined(__clang__)
#define WIDE __attribute__((target_clones("avx2", "default")))
#else
#define WIDE
#endif
#ifdef __GNUC__
#define INLINE static inline __attribute__((always_inline)) /* compiled for the caller's target */
#else
#define INLINE static inline
#endif

enum {
    /* Version: raise with every change of results or arguments, here and in loops/library.py. */
    FORM = 5,
    LANES = 8,     /* width of vectorised sums */
    NODES = 512,   /* most nodes of a rule: 16 rings of 32 */
    POINTS = 4184, /* most points of a lattice: 4181, padded to a multiple of LANES */
    CELLS = 16,    /* parts of an area light */
    CHANNELS = 9,  /* of a transfer vector: x, y, z for each colour */
    AZIMUTHS = 16, /* of a horizon map */
    CHUNK = 128,   /* pixels shaded together */
};

static const float HALF_PI = 1.57079632679f, INVERSE_PI = 0.31830988618f;

/* The height field, rows x columns. */
typedef struct {
    const float *heights;
    int32_t columns, rows;
    int32_t ends; /* border heights continue outwards; else the field repeats */
    float lift;   /* offset of shadow rays above the surface */
    double high, low, texel; /* extremes of the heights; a texel's side; plane units */
    const float *clear; /* tangent above which no ray from a texel is hidden, or NULL */
} Field;

/* Pixels of a block, arrays of `count`; NULL where no effect needs an array. */
typedef struct {
    int64_t count;
    const double *column, *row; /* on the material, in texels */
    /* Position in the scene; tangent, bitangent, normal there (NULL: x, y, z); height. */
    const float *point[3], *frame[9], *height;
    /* Direction to the camera and shading normal in that frame; n.v; GGX alpha. */
    const float *view[3], *normal[3], *n_dot_v, *alpha;
    const uint8_t *facing; /* 1 where the surface faces the camera */
    const float *wide;     /* side of the footprint, in texels */
    const float *diffuse[3], *specular[3];
    /* Multiple scattering: factor, index of the row in the table, the table (environment_map.py: lost). */
    const float *strength[3], *near, *lost;
    int32_t lost_size;
    float lost_step;
    float *total[3], *vector[9]; /* radiance; vector irradiance, x, y, z for each colour */
} Pixels;

typedef struct {
    const float *u, *cosine, *sine, *weight;
    int32_t points; /* a multiple of LANES, padded with weights of 0 */
} Lattice;

INLINE float larger(float a, float b) { return a > b ? a : b; }
INLINE float smaller(float a, float b) { return a < b ? a : b; }
INLINE float fifth(float x) { return x * x * (x * x) * x; }

INLINE float total(const float *values, int count) {
    float lanes[LANES] = {0}, sum = 0.0f;
    for (int n = 0; n < count; n += LANES)
        for (int k = 0; k < LANES; k++) lanes[k] += values[n + k];
    for (int k = 0; k < LANES; k++) sum += lanes[k];
    return sum;
}

/* Arctangent within 2e-7 (odd polynomial of degree 15 on [-1, 1], minimax). */
INLINE float arctangent(float x) {
    float size = fabsf(x);
    float t = size > 1.0f ? 1.0f / size : size;
    float s = t * t;
    float p = -0.0040540580f;
    p = p * s + 0.0218612286f;
    p = p * s - 0.0559098861f;
    p = p * s + 0.0964200441f;
    p = p * s - 0.1390853351f;
    p = p * s + 0.1994653599f;
    p = p * s - 0.3332985605f;
    p = p * s + 0.9999993329f;
    p *= t;
    p = size > 1.0f ? HALF_PI - p : p;
    return x < 0.0f ? -p : p;
}

/* D G / (4 n.l n.v): GGX from |n x h|^2 without cancellation, height-correlated Smith, as in
   matcap.brdf. h: l + v, not normalised. half: set to |l + v|^2 = 4 (l.h)^2. */
INLINE float ggx(const float n[3], const float h[3], float nl, float nv, float alpha,
                 float *half) {
    float squared = alpha * alpha, rest = 1.0f - squared, cosine = nl + nv;
    float size = larger(h[0] * h[0] + h[1] * h[1] + h[2] * h[2], 1e-20f);
    float ax = h[0] - cosine * n[0], ay = h[1] - cosine * n[1], az = h[2] - cosine * n[2];
    float spread = ax * ax + ay * ay + az * az + cosine * cosine * squared;
    float d = alpha * size / spread;
    float smith = sqrtf(nv * nv * rest + squared) * nl + sqrtf(nl * nl * rest + squared) * nv;
    *half = size;
    return d * d * 0.15915494309f / larger(smith, 1e-7f);
}

/* Schlick's (1 - l.h)^5, from |l + v|^2. */
INLINE float schlick(float half) { return fifth(larger(1.0f - sqrtf(half) * 0.5f, 0.0f)); }

/* 1 - E at a cosine: nearest entry of the table. */
INLINE float lost_at(const Pixels *p, float near, float cosine) {
    int32_t k = (int32_t)(cosine * p->lost_step + (near + 0.5f));
    return p->lost[k < p->lost_size ? k : p->lost_size - 1];
}

/* A vector of the scene in the material's frame. */
INLINE void to_frame(const Pixels *p, int64_t i, float v[3]) {
    if (!p->frame[0]) return;
    float x = v[0], y = v[1], z = v[2];
    for (int k = 0; k < 3; k++)
        v[k] = x * p->frame[3 * k][i] + y * p->frame[3 * k + 1][i] + z * p->frame[3 * k + 2][i];
}

/* ---- the height field ---- */

INLINE int32_t wrapped(int64_t i, int32_t size) {
    if (i >= 0 && i < size) return (int32_t)i;
    int32_t left = (int32_t)(i % size);
    return left < 0 ? left + size : left;
}

/* The texel nearest to a place. */
INLINE int64_t nearest(int32_t columns, int32_t rows, double column, double row) {
    int32_t c = wrapped((int64_t)rint(column), columns), r = wrapped((int64_t)rint(row), rows);
    return (int64_t)r * columns + c;
}

/* Index of grid line i, which may be beyond the border; after(): of the next line. */
INLINE int32_t within(const Field *f, int64_t i, int32_t size) {
    return !f->ends ? wrapped(i, size) : i < 0 ? 0 : i >= size ? size - 1 : (int32_t)i;
}

INLINE int32_t after(const Field *f, int64_t i, int32_t at, int32_t size) {
    if (f->ends && i < 0) return at;
    return at + 1 < size ? at + 1 : f->ends ? at : 0;
}

/* The bilinear surface at a place in columns and rows. */
INLINE float surface(const Field *f, double column, double row) {
    double left = floor(column), above = floor(row);
    float fx = (float)(column - left), fy = (float)(row - above);
    int32_t x = within(f, (int64_t)left, f->columns), y = within(f, (int64_t)above, f->rows);
    int32_t next = after(f, (int64_t)left, x, f->columns);
    const float *here = f->heights + (int64_t)y * f->columns;
    const float *below = f->heights + (int64_t)after(f, (int64_t)above, y, f->rows) * f->columns;
    float upper = here[x] + fx * (here[next] - here[x]);
    float lower = below[x] + fx * (below[next] - below[x]);
    return upper + fy * (lower - upper);
}

/* Whether a ray is below the surface on a grid line perpendicular to its axis `major`. There the
   bilinear surface is piecewise linear, and the test exact. */
INLINE int crossed(const Field *f, double major, double minor, double start, double other,
                   double height, double rise, double reach, int by_rows) {
    if (!(fabs(major) > 1e-9)) return 0;
    int32_t lines = by_rows ? f->rows : f->columns, places = by_rows ? f->columns : f->rows;
    int64_t stride = by_rows ? f->columns : 1, step = by_rows ? 1 : f->columns;
    int forward = major > 0.0 ? 1 : -1;
    double first = forward > 0 ? floor(start) + 1.0 : ceil(start) - 1.0;
    double pace = 1.0 / fabs(major);
    double track = fabs(first - start) * pace;
    if (!(track < reach)) return 0;
    int32_t line = within(f, (int64_t)first, lines);
    for (; track < reach; track += pace) {
        double cross = other + minor * track, low = floor(cross);
        float share = (float)(cross - low);
        int32_t j = within(f, (int64_t)low, places), beside = after(f, (int64_t)low, j, places);
        const float *at = f->heights + line * stride;
        float here = at[j * step], next = at[beside * step];
        if (here + share * (next - here) > height + rise * track) return 1;
        line += forward;
        if (line == lines || line < 0) line = (line < 0) == f->ends ? 0 : lines - 1;
    }
    return 0;
}

/* Whether light from direction (x, y, z), a unit vector, arrives at a place on the surface. */
INLINE int arrives(const Field *f, double column, double row, float height, float x, float y,
                   float z, double distance) {
    double h = (double)height + f->lift, rise = (double)z * f->texel;
    double reach = (f->high - h) / rise, far = distance / f->texel;
    reach = far < reach ? far : reach;
    return !crossed(f, x, -y, column, row, h, rise, reach, 0) &&
           !crossed(f, -y, x, row, column, h, rise, reach, 1);
}

/* Whether a direction is above a texel's horizon, interpolated between the nearest azimuths. */
INLINE int above_horizon(const float *tangents, float x, float y, float z) {
    float ax = fabsf(x), ay = fabsf(y), turn = ax > ay ? arctangent(ay / ax)
                                               : ay > 0.0f ? HALF_PI - arctangent(ax / ay) : 0.0f;
    turn = x < 0.0f ? 2.0f * HALF_PI - turn : turn;
    turn = (y < 0.0f ? -turn : turn) * (AZIMUTHS / (4.0f * HALF_PI));
    float low = floorf(turn), share = turn - low;
    int first = (int)low & (AZIMUTHS - 1), second = (first + 1) & (AZIMUTHS - 1);
    float tangent = tangents[first] + share * (tangents[second] - tangents[first]);
    return z > tangent * sqrtf(x * x + y * y);
}

/* Horizon maps. */
typedef struct {
    const float *tangents; /* AZIMUTHS a texel */
    int32_t columns, rows;
    int32_t adaptive; /* skip directions above the texel's highest horizon */
} Horizon;

INLINE const float *texel_horizon(const Horizon *h, const Pixels *p, int64_t i) {
    return h->tangents + AZIMUTHS * nearest(h->columns, h->rows, p->column[i], p->row[i]);
}

/* ---- visible normals [dupuy2023] ---- */

typedef struct {
    float n[3], v[3];    /* shading normal and view, unit vectors in the material's frame */
    float s[3], t[3];    /* tangents of n, times alpha */
    float m[3], vs[3];   /* middle of the spherical cap; view stretched to alpha = 1, unit */
    float nv, squared, flat, view; /* n.v, alpha^2, 1 - alpha^2, sqrt(a^2 + (1 - a^2) n.v^2) */
} Lobe;

INLINE Lobe lobe_of(const Pixels *p, int64_t i) {
    Lobe b;
    float alpha = p->alpha[i], x = p->normal[0][i], y = p->normal[1][i], z = p->normal[2][i];
    float sign = copysignf(1.0f, z), a = -1.0f / (sign + z), c = x * y * a; /* [duff2017] */
    float s[3] = {1.0f + sign * x * x * a, sign * c, -sign * x}, t[3] = {c, sign + y * y * a, -y};
    float vx = 0.0f, vy = 0.0f;
    b.nv = larger(p->n_dot_v[i], 1e-4f);
    for (int k = 0; k < 3; k++) {
        b.n[k] = p->normal[k][i], b.v[k] = p->view[k][i];
        b.s[k] = s[k] * alpha, b.t[k] = t[k] * alpha;
        vx += b.v[k] * b.s[k], vy += b.v[k] * b.t[k];
    }
    float inverse = 1.0f / sqrtf(vx * vx + vy * vy + b.nv * b.nv);
    b.vs[0] = vx * inverse, b.vs[1] = vy * inverse, b.vs[2] = b.nv * inverse;
    for (int k = 0; k < 3; k++) b.m[k] = b.s[k] * b.vs[0] + b.t[k] * b.vs[1] + b.n[k] * b.vs[2];
    b.squared = alpha * alpha, b.flat = 1.0f - b.squared;
    b.view = sqrtf(b.squared + b.flat * b.nv * b.nv);
    return b;
}

/* Mirrors the view at a sampled visible normal. l: the direction. fresnel: Schlick's weight.
   spread: D's denominator (n.h)^2 (alpha^2 - 1) + 1; the root of the sample's solid angle is
   proportional to it. Returns G2 / G1, 0 below the shading normal's horizon. */
INLINE float mirrored(const Lobe *b, float u, float cosine, float sine, float l[3], float *fresnel,
                      float *spread) {
    float z = (1.0f + b->vs[2]) * (1.0f - u) - b->vs[2];
    float ring = sqrtf(larger(1.0f - z * z, 0.0f)), x = ring * cosine, y = ring * sine, h[3];
    float reach = 0.0f, length = 0.0f;
    for (int c = 0; c < 3; c++) {
        h[c] = b->m[c] + b->s[c] * x + b->t[c] * y + b->n[c] * z;
        reach += b->v[c] * h[c];
        length += h[c] * h[c];
    }
    length = larger(length, 1e-20f);
    reach = larger(reach, 0.0f) * 2.0f / length;
    for (int c = 0; c < 3; c++) l[c] = reach * h[c] - b->v[c];
    float nl = reach * larger(z + b->vs[2], 1e-9f) - b->nv, safe = larger(nl, 1e-6f);
    float light = sqrtf(b->squared + b->flat * safe * safe);
    *fresnel = fifth(larger(1.0f - reach * sqrtf(0.25f * length), 0.0f));
    float apart = 2.0f + 2.0f * (x * b->vs[0] + y * b->vs[1] + z * b->vs[2]);
    *spread = apart / length * b->squared;
    float ratio = safe * (b->nv + b->view) / (safe * b->view + b->nv * light);
    return nl > 0.0f ? ratio : 0.0f;
}

#endif
