/* Inner loops of relighting: the plain ones of shadows.py, texel_horizons.py, environment.py and
   shade.py, compiled, for those pixels that a tile's budget picks out. compiled.py calls them.

   Sums are added up in another order than there, arctangents are a polynomial: results agree to
   about six digits, which tests/relight/test_relight_compiled.py holds them to. */

#include <math.h>
#include <stdint.h>

#if defined(__x86_64__) && defined(__linux__) && defined(__GNUC__) && !defined(__clang__)
#define WIDE __attribute__((target_clones("arch=haswell", "default")))
#else
#define WIDE
#endif
#ifdef __GNUC__
#define INLINE static inline __attribute__((always_inline)) /* as wide as what calls it */
#else
#define INLINE static inline
#endif

enum {
    /* Raised with every change of results or arguments, here and in compiled.py. */
    FORM = 1,
    LANES = 8,   /* numbers added up side by side */
    NODES = 512, /* of a rule, at most: 16 rings of 32 */
    POINTS = 4184, /* of a lattice, at most, and LANES - 1 more */
    CELLS = 16,  /* parts of a light */
    CHANNELS = 9,
    AZIMUTHS = 16, /* of horizons */
};

static const float HALF_PI = 1.57079632679f;

int32_t matcap_relight_form(void) { return FORM; }

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

/* ---- shadows ---- */

typedef struct {
    const float *heights; /* rows x columns */
    int32_t columns, rows;
    float lift; /* how far above the surface rays start */
    double high, texel;
} Field;

INLINE int32_t wrapped(int64_t i, int32_t size) {
    int32_t left = (int32_t)(i % size);
    return left < 0 ? left + size : left;
}

/* Whether a ray passes below the surface on a grid line across `major`; see shadows._crossed. */
static int crossed(const Field *f, double major, double minor, double start, double other,
                   double height, double rise, double reach, int by_rows) {
    if (!(fabs(major) > 1e-9)) return 0;
    int32_t lines = by_rows ? f->rows : f->columns, places = by_rows ? f->columns : f->rows;
    int64_t stride = by_rows ? f->columns : 1, step = by_rows ? 1 : f->columns;
    int forward = major > 0.0 ? 1 : -1;
    double first = forward > 0 ? floor(start) + 1.0 : ceil(start) - 1.0;
    double pace = 1.0 / fabs(major);
    double track = fabs(first - start) * pace;
    if (!(track < reach)) return 0;
    int32_t line = wrapped((int64_t)first, lines);
    for (; track < reach; track += pace) {
        double cross = other + minor * track, low = floor(cross);
        float share = (float)(cross - low);
        int32_t j = wrapped((int64_t)low, places);
        const float *at = f->heights + line * stride;
        float here = at[j * step], next = at[(j + 1 == places ? 0 : j + 1) * step];
        if (here + share * (next - here) > height + rise * track) return 1;
        line += forward;
        line = line == lines ? 0 : line < 0 ? lines - 1 : line;
    }
    return 0;
}

/* Whether light from a unit vector arrives at a place (columns and rows) on the surface. */
static int arrives(const Field *f, double column, double row, float height, float x, float y,
                   float z, double distance) {
    double h = (double)height + f->lift, rise = (double)z * f->texel;
    double reach = (f->high - h) / rise, far = distance / f->texel;
    reach = far < reach ? far : reach;
    return !crossed(f, x, -y, column, row, h, rise, reach, 0) &&
           !crossed(f, -y, x, row, column, h, rise, reach, 1);
}

void matcap_relight_lit(const Field *f, int64_t count, const double *column, const double *row,
                        const float *height, const float *x, const float *y, const float *z,
                        const float *distance, uint8_t *lit) {
    for (int64_t i = 0; i < count; i++)
        lit[i] = z[i] > 0.0f && arrives(f, column[i], row[i], height[i], x[i], y[i], z[i],
                                        distance ? distance[i] : HUGE_VAL);
}

/* ---- parallax ---- */

/* The surface at a place in columns and rows; see Relief.at. */
INLINE float surface(const Field *f, double column, double row) {
    double left = floor(column), above = floor(row);
    float fx = (float)(column - left), fy = (float)(row - above);
    int32_t x = wrapped((int64_t)left, f->columns), y = wrapped((int64_t)above, f->rows);
    const float *here = f->heights + (int64_t)y * f->columns;
    const float *below = f->heights + (int64_t)(y + 1 == f->rows ? 0 : y + 1) * f->columns;
    int32_t next = x + 1 == f->columns ? 0 : x + 1;
    float upper = here[x] + fx * (here[next] - here[x]);
    float lower = below[x] + fx * (below[next] - below[x]);
    return upper + fy * (lower - upper);
}

/* Heights at which rays meet the surface; see parallax._met. Columns and rows of places on the
   undisplaced surface, and how far rays move there per unit of height. peaks: the highest texel
   around each, within which `near` steps stay. */
void matcap_relight_met(const Field *f, const float *peaks, double low, int64_t count,
                        const double *column, const double *row, const double *across,
                        const double *down, const double *steps, const double *near,
                        float *found) {
    for (int64_t i = 0; i < count; i++) {
        double step = (f->high - low) / steps[i], index = 0.0;
        found[i] = (float)low;
        while (index <= steps[i]) {
            double level = f->high - step * index;
            double x = column[i] + across[i] * level, y = row[i] + down[i] * level;
            double gap = level - surface(f, x, y);
            if (gap <= 0.0) {
                /* The crossing of two straight lines between the last two steps. */
                double before = index > 0.0 ? level + step : level;
                double over = before - surface(f, column[i] + across[i] * before,
                                               row[i] + down[i] * before);
                double span = over - gap > 1e-12 ? over - gap : 1e-12;
                found[i] = (float)(before - (before - level) * (over / span));
                break;
            }
            /* Above the highest texel around there is nothing to meet. */
            int32_t c = wrapped((int64_t)rint(x), f->columns);
            int32_t r = wrapped((int64_t)rint(y), f->rows);
            double clear = (level - peaks[(int64_t)r * f->columns + c]) / (step > 1e-30 ? step : 1e-30);
            clear = floor(clear) - 1.0;
            clear = clear < near[i] ? clear : near[i];
            index += clear > 1.0 ? clear : 1.0;
        }
    }
}

/* ---- area lights ---- */

typedef struct {
    /* Of each pixel: place in the scene, the material's axes there (none: those of the scene),
       shading normal and view in the material's frame, cosine of the view, GGX alpha, where the
       table of lost energy begins. */
    const float *point[3], *frame[9], *normal[3], *view[3], *n_dot_v, *alpha, *near;
} Pixels;

typedef struct {
    /* A rectangle's nodes: places x, y, z, its normal and its area. A sphere's (if radius > 0):
       height on the cap, cosine and sine of the turn; its place and radius. */
    const float *a, *b, *c, *weight;
    const int32_t *cell; /* part of the light that each node is in */
    int32_t nodes, cells; /* nodes is a multiple of LANES; weights of those too many are 0 */
    float normal[3], area, place[3], radius;
} AreaLight;

typedef struct {
    float x[NODES], y[NODES], z[NODES], received[NODES], distance[NODES];
} Seen;

/* The light's nodes seen from a pixel: unit vectors in its frame, irradiance for radiance 1. */
INLINE void look_at(const AreaLight *l, const Pixels *p, int64_t i, Seen *s) {
    float px = p->point[0][i], py = p->point[1][i], pz = p->point[2][i];
    float m[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    if (p->frame[0])
        for (int k = 0; k < 9; k++) m[k] = p->frame[k][i];
    if (l->radius > 0.0f) {
        float ox = l->place[0] - px, oy = l->place[1] - py, oz = l->place[2] - pz;
        float squared = ox * ox + oy * oy + oz * oz, inverse = 1.0f / sqrtf(squared);
        float ax = (ox * m[0] + oy * m[1] + oz * m[2]) * inverse;
        float ay = (ox * m[3] + oy * m[4] + oz * m[5]) * inverse;
        float az = (ox * m[6] + oy * m[7] + oz * m[8]) * inverse;
        float sign = copysignf(1.0f, az), k = -1.0f / (sign + az), q = ax * ay * k;
        float sx = 1.0f + sign * ax * ax * k, sy = sign * q, sz = -sign * ax;
        float tx = q, ty = sign + ay * ay * k, tz = -ay;
        float sine2 = l->radius * l->radius / squared;
        sine2 = sine2 < 1.0f ? sine2 : 1.0f;
        float opening = sine2 / (1.0f + sqrtf(1.0f - sine2));
        float far = 1.0f / inverse - l->radius;
        far = far > 0.0f ? far : 0.0f;
        for (int n = 0; n < l->nodes; n++) {
            float drop = opening * l->a[n], cosine = 1.0f - drop;
            float sine = sqrtf(drop * (1.0f + cosine));
            float cs = l->b[n] * sine, sn = l->c[n] * sine;
            s->x[n] = ax * cosine + sx * cs + tx * sn;
            s->y[n] = ay * cosine + sy * cs + ty * sn;
            s->z[n] = az * cosine + sz * cs + tz * sn;
            s->received[n] = opening * l->weight[n];
            s->distance[n] = far;
        }
        return;
    }
    float nx = l->normal[0], ny = l->normal[1], nz = l->normal[2], area = l->area;
    for (int n = 0; n < l->nodes; n++) {
        float x = l->a[n] - px, y = l->b[n] - py, z = l->c[n] - pz;
        float squared = x * x + y * y + z * z, inverse = 1.0f / sqrtf(squared);
        float facing = -(x * nx + y * ny + z * nz) * inverse;
        facing = facing > 0.0f ? facing : 0.0f;
        s->received[n] = facing * area * l->weight[n] / squared;
        x *= inverse, y *= inverse, z *= inverse;
        s->x[n] = x * m[0] + y * m[1] + z * m[2];
        s->y[n] = x * m[3] + y * m[4] + z * m[5];
        s->z[n] = x * m[6] + y * m[7] + z * m[8];
        s->distance[n] = 1.0f / inverse;
    }
}

/* Share that arrives of each part of a light, (cells, count); see _Block.area_shadow. */
WIDE void matcap_relight_parts(const Field *f, const AreaLight *l, const Pixels *p, int64_t count,
                          const double *column, const double *row, const float *height,
                          const float *shelter, float *arriving) {
    Seen seen;
    for (int64_t i = 0; i < count; i++) {
        int risen[CELLS] = {0}, lit[CELLS] = {0};
        look_at(l, p, i, &seen);
        for (int n = 0; n < l->nodes; n++) {
            float x = seen.x[n], y = seen.y[n], z = seen.z[n];
            if (!(z > 0.0f) || l->weight[n] == 0.0f) continue;
            risen[l->cell[n]]++;
            lit[l->cell[n]] +=
                z >= shelter[i] * sqrtf(x * x + y * y) ||
                arrives(f, column[i], row[i], height[i], x, y, z, seen.distance[n]);
        }
        for (int c = 0; c < l->cells; c++)
            arriving[c * count + i] = risen[c] ? (float)lit[c] / (float)risen[c] : 1.0f;
    }
}

INLINE float total(const float *values, int count) {
    float lanes[LANES] = {0}, sum = 0.0f;
    for (int n = 0; n < count; n += LANES)
        for (int k = 0; k < LANES; k++) lanes[k] += values[n + k];
    for (int k = 0; k < LANES; k++) sum += lanes[k];
    return sum;
}

enum { DIFFUSE, MIRRORED, FRESNEL, LOST, FLOW_X, FLOW_Y, FLOW_Z, SUMS };

/* What the rule adds up to, (SUMS, count): irradiance, lobe times it, lobe times it and Schlick's
   weight, lost energy times it, and irradiance times direction. See _Block.add.

   shadow: (cells, count) share that arrives of each part, or NULL. lost: the table, or NULL. */
WIDE void matcap_relight_rule(const AreaLight *l, const Pixels *p, int64_t count,
                              const float *shadow, const float *lost, int32_t lost_size,
                              float lost_step, int32_t lobe, float *sums) {
    Seen s;
    float light[NODES], mirror[NODES], fresnel[NODES], gone[NODES];
    int nodes = l->nodes;
    for (int64_t i = 0; i < count; i++) {
        float nx = p->normal[0][i], ny = p->normal[1][i], nz = p->normal[2][i];
        float vx = p->view[0][i], vy = p->view[1][i], vz = p->view[2][i];
        float nv = p->n_dot_v[i], alpha = p->alpha[i], squared = alpha * alpha;
        float rest = 1.0f - squared, towards = sqrtf(nv * nv * rest + squared);
        look_at(l, p, i, &s);
        if (shadow) {
            float cell[CELLS];
            for (int c = 0; c < l->cells; c++) cell[c] = shadow[c * count + i];
            for (int n = 0; n < nodes; n++) s.received[n] *= cell[l->cell[n]];
        }
        for (int n = 0; n < nodes; n++) {
            float received = s.z[n] > 0.0f ? s.received[n] : 0.0f;
            float nl = nx * s.x[n] + ny * s.y[n] + nz * s.z[n];
            nl = nl > 0.0f ? nl : 0.0f;
            s.received[n] = received;
            light[n] = nl * received;
            fresnel[n] = nl;
        }
        sums[DIFFUSE * count + i] = total(light, nodes);
        if (lost) {
            float near = p->near[i] + 0.5f;
            for (int n = 0; n < nodes; n++) {
                int32_t k = (int32_t)(fresnel[n] * lost_step + near);
                gone[n] = lost[k < lost_size ? k : lost_size - 1] * light[n];
            }
            sums[LOST * count + i] = total(gone, nodes);
        }
        if (lobe) {
            for (int n = 0; n < nodes; n++) {
                float nl = fresnel[n];
                float hx = s.x[n] + vx, hy = s.y[n] + vy, hz = s.z[n] + vz;
                float half = hx * hx + hy * hy + hz * hz;
                half = half > 1e-20f ? half : 1e-20f;
                float cosine = nl + nv;
                float ax = hx - cosine * nx, ay = hy - cosine * ny, az = hz - cosine * nz;
                float spread = ax * ax + ay * ay + az * az + cosine * cosine * squared;
                float d = alpha * half / spread;
                float smith = towards * nl + sqrtf(nl * nl * rest + squared) * nv;
                smith = smith > 1e-7f ? smith : 1e-7f;
                d = d * d * 0.15915494309f / smith * light[n];
                float away = 1.0f - sqrtf(half) * 0.5f;
                away = away > 0.0f ? away : 0.0f;
                float power = away * away;
                power = power * power * away;
                mirror[n] = d;
                fresnel[n] = d * power;
            }
            sums[MIRRORED * count + i] = total(mirror, nodes);
            sums[FRESNEL * count + i] = total(fresnel, nodes);
        }
        for (int n = 0; n < nodes; n++) {
            s.x[n] *= s.received[n];
            s.y[n] *= s.received[n];
            s.z[n] *= s.received[n];
        }
        sums[FLOW_X * count + i] = total(s.x, nodes);
        sums[FLOW_Y * count + i] = total(s.y, nodes);
        sums[FLOW_Z * count + i] = total(s.z, nodes);
    }
}

/* ---- horizons ---- */

typedef struct {
    const float *padded; /* heights in texels, the repetition around */
    const float *lit;    /* rows of CHANNELS: what each texel reflects, padded likewise */
    const float *cosine, *sine;          /* of each azimuth */
    const int32_t *offset, *middle;      /* azimuths x steps, azimuths x parts: in texels */
    const float *inverse;                /* azimuths x steps: of the distance */
    const int32_t *end;                  /* of each part: the step after its last */
    const float *nearest;                /* of each part: inverse of its least distance */
    int32_t steps, parts;
    float highest;
} Walk;

/* See horizons.strip. */
INLINE float strip(float tangent, float side, float nz) {
    float squared = tangent * tangent, share = 1.0f / (1.0f + squared);
    return 0.5f * (side * (arctangent(tangent) + tangent * share) + nz * squared * share);
}

/* Horizons of all azimuths after a part's steps; whether any of them could rise further. */
INLINE int walked(const Walk *w, int part, int64_t spot, float own, float *level) {
    float room = (w->highest - own) * w->nearest[part];
    int more = 0, first = part ? w->end[part - 1] : 0, end = w->end[part];
    for (int a = 0; a < AZIMUTHS; a++) {
        const int32_t *offset = w->offset + a * w->steps;
        const float *inverse = w->inverse + a * w->steps;
        float highest = level[a];
        if (!(room > highest)) continue;
        for (int k = first; k < end; k++) {
            float rise = (w->padded[spot + offset[k]] - own) * inverse[k];
            highest = rise > highest ? rise : highest;
        }
        level[a] = highest;
        more = 1;
    }
    return more;
}

/* Horizons (count, AZIMUTHS), and (count, 2) what they leave open; see TexelHorizons._look. */
WIDE void matcap_relight_look(const Walk *w, int64_t count, const int64_t *spot, const float *own,
                              const float *sx, const float *sy, const float *nz, float *tangents,
                              float *open) {
    for (int64_t i = 0; i < count; i++) {
        float first[AZIMUTHS], level[AZIMUTHS], seen[AZIMUTHS], faced[AZIMUTHS];
        for (int a = 0; a < AZIMUTHS; a++)
            level[a] = first[a] = w->cosine[a] * sx[i] + w->sine[a] * sy[i];
        for (int part = 0; part < w->parts && walked(w, part, spot[i], own[i], level); part++) {
        }
        for (int a = 0; a < AZIMUTHS; a++) {
            float side = -first[a] * nz[i], above = strip(level[a], side, nz[i]);
            faced[a] = above - strip(first[a], side, nz[i]);
            seen[a] = side * (0.5f * HALF_PI) + nz[i] * 0.5f - (level[a] > 0.0f ? above : 0.0f);
            tangents[i * AZIMUTHS + a] = level[a];
        }
        float share = total(seen, AZIMUTHS) * (4.0f / AZIMUTHS) / (1.0f + nz[i]);
        open[2 * i] = share < 0.0f ? 0.0f : share > 1.0f ? 1.0f : share;
        open[2 * i + 1] = total(faced, AZIMUTHS) * (2.0f / AZIMUTHS);
    }
}

/* (count, CHANNELS) transfer vectors; see TexelHorizons._gather. */
WIDE void matcap_relight_gather(const Walk *w, int64_t count, const int64_t *spot,
                                const float *own, const float *sx, const float *sy,
                                const float *nz, float *found) {
    for (int64_t i = 0; i < count; i++) {
        float level[AZIMUTHS], side[AZIMUTHS], weight[AZIMUTHS], share[AZIMUTHS];
        float sum[CHANNELS] = {0};
        for (int a = 0; a < AZIMUTHS; a++) {
            level[a] = w->cosine[a] * sx[i] + w->sine[a] * sy[i];
            side[a] = -level[a] * nz[i];
            weight[a] = strip(level[a], side[a], nz[i]);
        }
        for (int part = 0; part < w->parts && walked(w, part, spot[i], own[i], level); part++) {
            for (int a = 0; a < AZIMUTHS; a++) {
                float higher = strip(level[a], side[a], nz[i]);
                share[a] = higher - weight[a];
                weight[a] = higher;
            }
            for (int a = 0; a < AZIMUTHS; a++) {
                if (share[a] == 0.0f) continue;
                const float *lit = w->lit + CHANNELS * (spot[i] + w->middle[a * w->parts + part]);
                for (int c = 0; c < CHANNELS; c++) sum[c] += share[a] * lit[c];
            }
        }
        for (int c = 0; c < CHANNELS; c++) found[i * CHANNELS + c] = sum[c];
    }
}

/* ---- surroundings ---- */

typedef struct {
    /* Of each pixel, as visible_normals.Lobe. */
    const float *normal[3], *view[3], *across[3], *along[3], *middle[3], *stretched[3];
    const float *n_dot_v, *alpha;
} Lobes;

typedef struct {
    const float *u, *cosine, *sine, *weight;
    int32_t points; /* a multiple of LANES; weights of those too many are 0 */
} Lattice;

static int clear(const float *tangents, float x, float y, float z) {
    float ax = fabsf(x), ay = fabsf(y), turn = ax > ay ? arctangent(ay / ax)
                                               : ay > 0.0f ? HALF_PI - arctangent(ax / ay) : 0.0f;
    turn = x < 0.0f ? 2.0f * HALF_PI - turn : turn;
    turn = (y < 0.0f ? -turn : turn) * (AZIMUTHS / (4.0f * HALF_PI));
    float low = floorf(turn), share = turn - low;
    int first = (int)low & (AZIMUTHS - 1), second = (first + 1) & (AZIMUTHS - 1);
    float tangent = tangents[first] + share * (tangents[second] - tangents[first]);
    return z > tangent * sqrtf(x * x + y * y);
}

/* Share of even surroundings that is hidden, times F0 and on its own; see environment.hidden.

   tangents: horizons of texels, AZIMUTHS each, or NULL; highest: sines of the highest. */
WIDE void matcap_relight_hidden(const Lobes *l, const Lattice *at, int64_t count,
                                const float *tangents, const int64_t *texel, const float *highest,
                                float *scale, float *bias) {
    int32_t low[POINTS];
    for (int64_t i = 0; i < count; i++) {
        float vx = l->stretched[0][i], vy = l->stretched[1][i], vz = l->stretched[2][i];
        float mz = l->middle[2][i], az = l->across[2][i], bz = l->along[2][i];
        float nz = l->normal[2][i], nv = l->n_dot_v[i], squared = l->alpha[i] * l->alpha[i];
        float flat = 1.0f - squared, stretch = 2.0f * nv / vz;
        float limit = highest[i] + l->view[2][i], least = nv * (1.0f - 1e-5f);
        for (int k = 0; k < at->points; k++) {
            float z = (1.0f + vz) * (1.0f - at->u[k]) - vz, ring = 1.0f - z * z;
            ring = sqrtf(ring > 0.0f ? ring : 0.0f);
            float a = ring * at->cosine[k], b = ring * at->sine[k];
            float half = mz + az * a + bz * b + nz * z, tilt = z + vz;
            float apart = a * vx + b * vy + 1.0f + z * vz;
            float length = tilt * tilt * flat + apart * (2.0f * squared);
            float reach = apart * stretch / (length > 1e-20f ? length : 1e-20f);
            low[k] = (half * reach - limit <= 0.0f) & (tilt * reach > least);
        }
        float plain = 0.0f, mixed = 0.0f, view = sqrtf(squared + flat * nv * nv);
        for (int k = 0; k < at->points; k++) {
            if (!low[k] || at->weight[k] == 0.0f) continue;
            float z = (1.0f + vz) * (1.0f - at->u[k]) - vz, ring = 1.0f - z * z;
            ring = sqrtf(ring > 0.0f ? ring : 0.0f);
            float a = ring * at->cosine[k], b = ring * at->sine[k], h[3], reach = 0.0f;
            float length = 0.0f;
            for (int c = 0; c < 3; c++) {
                h[c] = l->middle[c][i] + l->across[c][i] * a + l->along[c][i] * b +
                       l->normal[c][i] * z;
                reach += l->view[c][i] * h[c];
                length += h[c] * h[c];
            }
            length = length > 1e-20f ? length : 1e-20f;
            reach = reach > 0.0f ? 2.0f * reach / length : 0.0f;
            float tilt = z + vz > 1e-9f ? z + vz : 1e-9f, nl = reach * tilt - nv;
            if (!(nl > 0.0f)) continue;
            float rise = reach * h[2] - l->view[2][i];
            if (rise > 0.0f &&
                (!tangents ||
                 clear(tangents + texel[i] * AZIMUTHS, reach * h[0] - l->view[0][i],
                       reach * h[1] - l->view[1][i], rise)))
                continue;
            nl = nl > 1e-6f ? nl : 1e-6f;
            float light = sqrtf(squared + flat * nl * nl);
            float weight = at->weight[k] * nl * (nv + view) / (nl * view + nv * light);
            float away = 1.0f - reach * sqrtf(0.25f * length);
            away = away > 0.0f ? away : 0.0f;
            float power = away * away;
            power *= power * away * weight;
            mixed += power;
            plain += weight - power;
        }
        scale[i] = plain;
        bias[i] = mixed;
    }
}
