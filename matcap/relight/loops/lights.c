/* Point and directional lights: lobes, falloff, multiple scattering, shadows. */

#include "loops.h"

int32_t matcap_relight_form(void) { return FORM; }

enum { DIFFUSE = 1, SPECULAR = 2, LOST = 4, VECTOR = 8 };

typedef struct {
    /* Direction to it if `far`, else position; `faces`: emits around `normal` only. */
    float place[3], normal[3], colour[3];
    int32_t far, faces, parts;
    float power; /* radiant intensity along the normal, for colour 1 */
    float even;  /* without falloff 1 / (squared distance from the origin), else 0 */
} Lamp;

typedef struct {
    float x[CHUNK], y[CHUNK], z[CHUNK], received[CHUNK], distance[CHUNK];
} Rays;

/* Directions to the light in the pixels' frames, irradiance facing it, distance. */
INLINE void look_at(const Pixels *p, const Lamp *l, int64_t first, int count, Rays *r) {
    const float *px = p->point[0] + first, *py = p->point[1] + first, *pz = p->point[2] + first;
    for (int k = 0; k < count && l->far; k++) {
        r->x[k] = l->place[0], r->y[k] = l->place[1], r->z[k] = l->place[2];
        r->received[k] = l->power, r->distance[k] = HUGE_VALF;
    }
    for (int k = 0; k < count && !l->far; k++) {
        float x = l->place[0] - px[k], y = l->place[1] - py[k], z = l->place[2] - pz[k];
        float inverse = 1.0f / sqrtf(larger(x * x + y * y + z * z, 1e-12f));
        x *= inverse, y *= inverse, z *= inverse;
        float facing = l->faces ? -(x * l->normal[0] + y * l->normal[1] + z * l->normal[2]) : 1.0f;
        float fall = l->even > 0.0f ? l->even : inverse * inverse;
        r->received[k] = larger(facing, 0.0f) * fall * l->power;
        r->x[k] = x, r->y[k] = y, r->z[k] = z, r->distance[k] = 1.0f / inverse;
    }
    if (!p->frame[0]) return;
    const float *const *m = p->frame;
    for (int k = 0; k < count; k++) {
        float x = r->x[k], y = r->y[k], z = r->z[k];
        int64_t i = first + k;
        r->x[k] = x * m[0][i] + y * m[1][i] + z * m[2][i];
        r->y[k] = x * m[3][i] + y * m[4][i] + z * m[5][i];
        r->z[k] = x * m[6][i] + y * m[7][i] + z * m[8][i];
    }
}

/* Irradiance; lobe (F = 1) times it, and times Schlick's weight; multiple scattering's factor. */
typedef struct {
    float light[CHUNK], mirror[CHUNK], weight[CHUNK], lost[CHUNK];
} Reflected;

INLINE void reflect(const Pixels *p, int64_t first, int count, const Rays *r, int parts,
                    Reflected *o) {
    for (int k = 0; k < count; k++) {
        int64_t i = first + k;
        float n[3] = {p->normal[0][i], p->normal[1][i], p->normal[2][i]};
        float nl = larger(n[0] * r->x[k] + n[1] * r->y[k] + n[2] * r->z[k], 0.0f), half;
        float h[3] = {r->x[k] + p->view[0][i], r->y[k] + p->view[1][i], r->z[k] + p->view[2][i]};
        float light = nl * r->received[k];
        float mirror = ggx(n, h, nl, p->n_dot_v[i], p->alpha[i], &half) * light;
        o->light[k] = light, o->mirror[k] = mirror, o->weight[k] = schlick(half) * mirror;
    }
    if (parts & LOST)
        for (int k = 0; k < count; k++) {
            int64_t i = first + k;
            float nl = p->normal[0][i] * r->x[k] + p->normal[1][i] * r->y[k] +
                       p->normal[2][i] * r->z[k];
            o->lost[k] = lost_at(p, p->near[i], larger(nl, 0.0f)) * o->light[k];
        }
}

INLINE void add(const Pixels *p, const Lamp *l, int64_t first, int count, const Rays *r,
                const Reflected *o) {
    for (int c = 0; c < 3; c++) {
        /* One addition a light: two equal lights are exactly twice one. */
        float *restrict sum = p->total[c] + first, colour = l->colour[c], value[CHUNK] = {0};
        const float *albedo = p->diffuse[c] + first, *f0 = p->specular[c] + first;
        if (l->parts & SPECULAR)
            for (int k = 0; k < count; k++)
                value[k] = f0[k] * (o->mirror[k] - o->weight[k]) + o->weight[k];
        if (l->parts & LOST) {
            const float *strength = p->strength[c] + first;
            for (int k = 0; k < count; k++) value[k] += strength[k] * o->lost[k];
        }
        if (l->parts & DIFFUSE)
            for (int k = 0; k < count; k++) value[k] += albedo[k] * (o->light[k] * INVERSE_PI);
        for (int k = 0; k < count; k++) sum[k] += value[k] * colour;
        for (int axis = 0; axis < 3 && l->parts & VECTOR; axis++) {
            const float *towards = axis == 0 ? r->x : axis == 1 ? r->y : r->z;
            float *restrict vector = p->vector[3 * c + axis] + first;
            for (int k = 0; k < count; k++) vector[k] += towards[k] * r->received[k] * colour;
        }
    }
}

/* Starts of a pixel's shadow rays, in shares of its footprint: one in each row and column of 4 x 4
   cells (a rotated grid), for partial shadows. */
enum { STARTS = 4 };
static const float START[STARTS][2] = {
    {-0.125f, -0.375f}, {0.375f, -0.125f}, {0.125f, 0.375f}, {-0.375f, 0.125f}};
static const float WIDEST = 64.0f; /* texels */

INLINE float share_lit(const Pixels *p, const Field *f, int64_t i, const Rays *r, int k) {
    float wide = smaller(p->wide[i], WIDEST), lit = 0.0f;
    for (int s = 0; s < STARTS; s++) {
        double column = p->column[i] + wide * START[s][0], row = p->row[i] + wide * START[s][1];
        lit += (float)arrives(f, column, row, surface(f, column, row), r->x[k], r->y[k], r->z[k],
                              r->distance[k]);
    }
    return lit / STARTS;
}

/* Share of a light that arrives: past the height field, or above horizon maps; either may be NULL.
   cast: set to 1 where shadow rays were cast. */
WIDE void matcap_relight_past(const Pixels *p, const Lamp *l, const Field *field,
                              const Horizon *horizon, float *lit, uint8_t *cast) {
    Rays r;
    for (int64_t first = 0; first < p->count; first += CHUNK) {
        int count = p->count - first < CHUNK ? (int)(p->count - first) : CHUNK;
        look_at(p, l, first, count, &r);
        for (int k = 0; k < count; k++) {
            int64_t i = first + k;
            float nl = p->normal[0][i] * r.x[k] + p->normal[1][i] * r.y[k] +
                       p->normal[2][i] * r.z[k];
            /* With interreflection, light behind the shading normal counts: for neighbours. */
            if (!p->facing[i] || !(r.z[k] > 0.0f) || !(r.received[k] > 0.0f) ||
                (!(l->parts & VECTOR) && !(nl > 0.0f)))
                continue;
            if (field) lit[i] = share_lit(p, field, i, &r, k), cast[i] = 1;
            if (horizon)
                lit[i] =
                    (float)above_horizon(texel_horizon(horizon, p, i), r.x[k], r.y[k], r.z[k]);
        }
    }
}

/* Adds a point or directional light. lit: share that arrives; NULL is 1. */
WIDE void matcap_relight_lamp(const Pixels *p, const Lamp *l, const float *lit) {
    Rays r;
    Reflected o;
    for (int64_t first = 0; first < p->count; first += CHUNK) {
        int count = p->count - first < CHUNK ? (int)(p->count - first) : CHUNK;
        look_at(p, l, first, count, &r);
        for (int k = 0; k < count; k++) r.received[k] = r.z[k] > 0.0f ? r.received[k] : 0.0f;
        for (int k = 0; k < count && lit; k++)
            r.received[k] *= lit[first + k];
        reflect(p, first, count, &r, l->parts, &o);
        add(p, l, first, count, &r, &o);
    }
}

/* D G / (4 n.l n.v) and Schlick's weight of `count` pairs of directions. */
WIDE void matcap_relight_lobe(int64_t count, const float *normal, const float *view,
                              const float *light, const float *alpha, float *lobe,
                              float *weight) {
    for (int64_t i = 0; i < count; i++) {
        float n[3], h[3], nl = 0.0f, nv = 0.0f, half;
        for (int k = 0; k < 3; k++) {
            n[k] = normal[k * count + i], h[k] = light[k * count + i] + view[k * count + i];
            nl += n[k] * light[k * count + i], nv += n[k] * view[k * count + i];
        }
        lobe[i] = ggx(n, h, larger(nl, 0.0f), larger(nv, 0.0f), alpha[i], &half);
        weight[i] = schlick(half);
    }
}
