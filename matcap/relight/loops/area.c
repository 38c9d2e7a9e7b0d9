/* Area lights by quadrature: the order by pixel, shadows by part of the light (effects/area.py). */

#include "loops.h"

/* SAMPLED has no rule: the lobe is sampled. SETTING: the least rule where a light sets; TURNED:
   where, with a budget, a rectangle sets behind the shading normal alone. */
enum { RULES = 7, SAMPLED = 7, SETTING = 5, TURNED = 4 };

typedef struct {
    /* Nodes of a rectangle: x, y, z in the scene. Of a sphere: height on its cap of directions,
       cosine and sine of the azimuth. Weights; the part of the light that each node is in. */
    const float *a, *b, *c, *weight;
    const int32_t *cell;
    int32_t nodes, order; /* nodes is a multiple of LANES, padded with weights of 0 */
} Rule;

typedef struct {
    float place[3], colour[3];
    float normal[3], across[3], along[3], size[2]; /* of a rectangle */
    float radius;                                  /* of a sphere, else 0 */
    float half;                                    /* radius of its bounding sphere */
    float even; /* without falloff 1 / (squared distance from the origin), else 0 */
    /* Orders by lobe: see effects/area.py. */
    float density, rate, spread, turn;
    int32_t diffuse, specular, limits[RULES - 1];
    Rule plain[RULES + 1], parted[RULES + 1], probe;
} AreaLight;

typedef struct {
    float x[NODES], y[NODES], z[NODES], received[NODES], distance[NODES];
} Seen;

/* The nodes as seen from a pixel: unit vectors in its frame, irradiance of radiance 1, distance. */
INLINE void look_at(const AreaLight *l, const Rule *r, const Pixels *p, int64_t i, Seen *s) {
    float px = p->point[0][i], py = p->point[1][i], pz = p->point[2][i];
    float m[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    if (p->frame[0])
        for (int k = 0; k < 9; k++) m[k] = p->frame[k][i];
    if (l->radius > 0.0f) {
        float o[3] = {l->place[0] - px, l->place[1] - py, l->place[2] - pz};
        float squared = o[0] * o[0] + o[1] * o[1] + o[2] * o[2], inverse = 1.0f / sqrtf(squared);
        float ax = (o[0] * m[0] + o[1] * m[1] + o[2] * m[2]) * inverse;
        float ay = (o[0] * m[3] + o[1] * m[4] + o[2] * m[5]) * inverse;
        float az = (o[0] * m[6] + o[1] * m[7] + o[2] * m[8]) * inverse;
        float sign = copysignf(1.0f, az), k = -1.0f / (sign + az), q = ax * ay * k;
        float sx = 1.0f + sign * ax * ax * k, sy = sign * q, sz = -sign * ax;
        float tx = q, ty = sign + ay * ay * k, tz = -ay;
        float sine2 = smaller(l->radius * l->radius / squared, 1.0f);
        /* 1 - cos of the cone's half angle, without cancellation for small lights. */
        float opening = sine2 / (1.0f + sqrtf(1.0f - sine2));
        float far = larger(1.0f / inverse - l->radius, 0.0f);
        for (int n = 0; n < r->nodes; n++) {
            float drop = opening * r->a[n], cosine = 1.0f - drop;
            float sine = sqrtf(drop * (1.0f + cosine));
            float cs = r->b[n] * sine, sn = r->c[n] * sine;
            s->x[n] = ax * cosine + sx * cs + tx * sn;
            s->y[n] = ay * cosine + sy * cs + ty * sn;
            s->z[n] = az * cosine + sz * cs + tz * sn;
            s->received[n] = opening * r->weight[n];
            s->distance[n] = far;
        }
        return;
    }
    float nx = l->normal[0], ny = l->normal[1], nz = l->normal[2], area = l->size[0] * l->size[1];
    for (int n = 0; n < r->nodes; n++) {
        float x = r->a[n] - px, y = r->b[n] - py, z = r->c[n] - pz;
        float squared = x * x + y * y + z * z, inverse = 1.0f / sqrtf(squared);
        float facing = larger(-(x * nx + y * ny + z * nz) * inverse, 0.0f);
        s->received[n] = facing * area * r->weight[n] / squared;
        x *= inverse, y *= inverse, z *= inverse;
        s->x[n] = x * m[0] + y * m[1] + z * m[2];
        s->y[n] = x * m[3] + y * m[4] + z * m[5];
        s->z[n] = x * m[6] + y * m[7] + z * m[8];
        s->distance[n] = 1.0f / inverse;
    }
}

/* ---- choice of the rule ---- */

/* The first rule with at least `needed` points along a side, counted from 1; or SAMPLED. */
INLINE int number(const AreaLight *l, float needed) {
    int one = 1;
    while (one < RULES && !(needed <= l->limits[one - 1])) one++;
    return one;
}

/* Half the extent of a light along an axis of the material's frame. */
INLINE float extent(const AreaLight *l, const float side[2][3], const float axis[3]) {
    if (l->radius > 0.0f) return l->radius;
    float reach = 0.0f;
    for (int k = 0; k < 2; k++)
        reach += 0.5f * l->size[k] *
                 fabsf(side[k][0] * axis[0] + side[k][1] * axis[1] + side[k][2] * axis[2]);
    return reach;
}

/* The rule for a pixel, 0 where the light is below its horizon; `sets`: the least rule of a
   light that is partly below, else 0.

   Without `adaptive` the order follows from the light's angle over the lobe's width, wherever the
   lobe points. With it, also from the distance of the light from the lobe's peak: GGX is
   (alpha^2 + t^2)^-2 in the tangent t between normal and microfacet, and the convergence of
   Gauss-Legendre depends on how far the singularity t = +-i alpha is from the light's range of t. */
static int chosen(const AreaLight *l, const Pixels *p, int64_t i, int adaptive, int *sets) {
    float o[3], h[3], distance = 0.0f, nl = 0.0f, squared = 0.0f, alpha = p->alpha[i];
    for (int k = 0; k < 3; k++) o[k] = l->place[k] - p->point[k][i], distance += o[k] * o[k];
    distance = sqrtf(distance);
    float angle = arctangent(l->half / larger(distance - l->half, 1e-6f));
    float needed = 3.0f + ceilf(l->density * angle / (2.0f * larger(alpha, 1e-6f)) + 6.0f * angle);
    int plain = number(l, needed);
    *sets = SETTING;
    if (!adaptive) return plain;
    float n[3], up[3] = {0.0f, 0.0f, 1.0f}, side[2][3];
    to_frame(p, i, o);
    for (int k = 0; k < 3; k++) {
        n[k] = p->normal[k][i], side[0][k] = l->across[k], side[1][k] = l->along[k];
        nl += n[k] * o[k];
    }
    to_frame(p, i, side[0]), to_frame(p, i, side[1]);
    float tilted = extent(l, side, n), level = extent(l, side, up);
    if (o[2] + level < 0.0f) return 0;
    *sets = o[2] < level ? SETTING : 0;
    /* A light behind the shading normal still lights neighbours. */
    if (nl + tilted < 0.0f) return p->vector[0] ? 1 : 0;
    if (nl < tilted && !*sets) *sets = l->radius > 0.0f ? SETTING : TURNED;
    if (*sets || plain >= SAMPLED) return plain;
    for (int k = 0; k < 3; k++)
        h[k] = o[k] / distance + p->view[k][i], squared += h[k] * h[k];
    float cosine = larger(nl / distance + p->n_dot_v[i], 1e-6f);
    /* The microfacet turns by half the light's angle, a little more at grazing views: `turn`. */
    float away = sqrtf(larger(squared - cosine * cosine, 0.0f)) / cosine;
    float near = tanf(angle * l->turn), clear = larger((away - near) / (1.0f + away * near), 0.0f);
    float sharp = sqrtf(alpha * alpha + clear * clear);
    int fewer = number(l, 2.0f + l->rate * angle / sharp + l->spread * angle);
    return fewer < plain ? fewer : plain;
}

/* ---- integration ---- */

/* Visible share of each part of a light; returns whether all parts are fully visible. */
INLINE int parts_lit(const AreaLight *l, const Pixels *p, int64_t i, const Field *f, Seen *s,
                     float *arriving) {
    int risen[CELLS] = {0}, lit[CELLS] = {0}, clear = 1;
    float above = 1.0f;
    for (int c = 0; c < CELLS; c++) arriving[c] = 1.0f;
    if (f->clear) {
        float tangent = f->clear[nearest(f->columns, f->rows, p->column[i], p->row[i])];
        float o[3], distance = 0.0f;
        above = tangent / sqrtf(1.0f + tangent * tangent);
        for (int k = 0; k < 3; k++) o[k] = l->place[k] - p->point[k][i], distance += o[k] * o[k];
        to_frame(p, i, o);
        /* The lowest point of the bounding sphere, as if it were the farthest, too. */
        if (o[2] - l->half > above * (sqrtf(distance) + l->half)) return 1;
    }
    look_at(l, &l->probe, p, i, s);
    for (int n = 0; n < l->probe.nodes; n++) {
        /* Nodes below the surface's own horizon are no matter of shadows. */
        if (!(s->z[n] > 0.0f) || l->probe.weight[n] == 0.0f) continue;
        int one = s->z[n] > above || arrives(f, p->column[i], p->row[i], p->height[i], s->x[n], s->y[n], s->z[n],
                          s->distance[n]);
        risen[l->probe.cell[n]]++, lit[l->probe.cell[n]] += one, clear &= one;
    }
    for (int c = 0; c < CELLS; c++)
        if (risen[c]) arriving[c] = (float)lit[c] / (float)risen[c];
    return clear;
}

/* Adds the light of a rule's nodes, times the visible share of their parts (shadow, or NULL). */
INLINE void integrate(const AreaLight *l, const Rule *r, const Pixels *p, int64_t i,
                      const float *shadow, int lobe, float fading, Seen *s) {
    float light[NODES], cosine[NODES], sums[3] = {0}; /* lobe, with Schlick's weight, lost */
    float n[3] = {p->normal[0][i], p->normal[1][i], p->normal[2][i]};
    float v[3] = {p->view[0][i], p->view[1][i], p->view[2][i]};
    float nv = p->n_dot_v[i], alpha = p->alpha[i];
    int nodes = r->nodes;
    look_at(l, r, p, i, s);
    for (int k = 0; k < nodes && shadow; k++) s->received[k] *= shadow[r->cell[k]];
    for (int k = 0; k < nodes; k++) {
        float received = s->z[k] > 0.0f ? s->received[k] : 0.0f;
        float nl = larger(n[0] * s->x[k] + n[1] * s->y[k] + n[2] * s->z[k], 0.0f);
        s->received[k] = received, light[k] = nl * received, cosine[k] = nl;
    }
    float lambert = total(light, nodes) * INVERSE_PI;
    if (p->near) {
        float gone[NODES];
        for (int k = 0; k < nodes; k++) gone[k] = lost_at(p, p->near[i], cosine[k]) * light[k];
        sums[2] = total(gone, nodes);
    }
    if (lobe) {
        float mirror[NODES];
        for (int k = 0; k < nodes; k++) {
            float h[3] = {s->x[k] + v[0], s->y[k] + v[1], s->z[k] + v[2]}, half;
            float d = ggx(n, h, cosine[k], nv, alpha, &half) * light[k];
            mirror[k] = d, cosine[k] = d * schlick(half);
        }
        sums[0] = total(mirror, nodes), sums[1] = total(cosine, nodes);
    }
    for (int c = 0; c < 3; c++) {
        float value = l->diffuse ? p->diffuse[c][i] * lambert : 0.0f;
        if (lobe) value += p->specular[c][i] * (sums[0] - sums[1]) + sums[1];
        if (p->near) value += p->strength[c][i] * sums[2];
        p->total[c][i] += value * fading * l->colour[c];
    }
    if (!p->vector[0]) return;
    float *const towards[3] = {s->x, s->y, s->z};
    for (int axis = 0; axis < 3; axis++) {
        for (int k = 0; k < nodes; k++) towards[axis][k] *= s->received[k];
        float vector = total(towards[axis], nodes) * fading;
        for (int c = 0; c < 3; c++) p->vector[3 * c + axis][i] += vector * l->colour[c];
    }
}

/* Whether a ray from a pixel, direction d, meets a sphere, its middle at o, or a rectangle, of which
   `axes` are across, along and normal; all in the material's frame. */
INLINE int meets_sphere(float radius, const float o[3], const float d[3]) {
    float x = d[1] * o[2] - d[2] * o[1], y = d[2] * o[0] - d[0] * o[2];
    float z = d[0] * o[1] - d[1] * o[0], along = d[0] * o[0] + d[1] * o[1] + d[2] * o[2];
    return (x * x + y * y + z * z <= radius * radius) & (along > 0.0f);
}

INLINE int meets_rectangle(float width, float height, const float axes[3][3], const float o[3],
                           const float d[3]) {
    float facing = 0.0f, reach = 0.0f, a = 0.0f, b = 0.0f;
    for (int k = 0; k < 3; k++) facing -= d[k] * axes[2][k], reach -= o[k] * axes[2][k];
    reach /= larger(facing, 1e-6f);
    for (int k = 0; k < 3; k++) {
        float miss = d[k] * reach - o[k];
        a += miss * axes[0][k], b += miss * axes[1][k];
    }
    float beyond = larger(fabsf(a) - 0.5f * width, fabsf(b) - 0.5f * height);
    return (smaller(facing - 1e-6f, reach) > 0.0f) & (beyond <= 0.0f);
}

/* Weights of a lobe's samples, and those times Schlick's weight; 0 where they miss the light. */
INLINE void look_along(const AreaLight *l, const Lattice *at, const Lobe *b, const float o[3],
                       const float axes[3][3], int round, float *met, float *mixed) {
    float radius = l->radius, width = l->size[0], height = l->size[1];
    for (int k = 0; k < at->points; k++) {
        float d[3], fresnel, spread, share = at->weight[k];
        share *= mirrored(b, at->u[k], at->cosine[k], at->sine[k], d, &fresnel, &spread);
        int meets = round ? meets_sphere(radius, o, d)
                          : meets_rectangle(width, height, axes, o, d);
        met[k] = (d[2] > 0.0f) & meets ? share : 0.0f;
        mixed[k] = met[k] * fresnel;
    }
}

/* Adds the specular lobe by sampling visible normals, for a light too large for any rule. */
INLINE void sampled(const AreaLight *l, const Lattice *at, const Pixels *p, int64_t i, float seen) {
    Lobe b = lobe_of(p, i);
    float o[3], axes[3][3], met[POINTS], mixed[POINTS];
    for (int k = 0; k < 3; k++) {
        o[k] = l->place[k] - p->point[k][i];
        axes[0][k] = l->across[k], axes[1][k] = l->along[k], axes[2][k] = l->normal[k];
    }
    to_frame(p, i, o);
    for (int k = 0; k < 3; k++) to_frame(p, i, axes[k]);
    if (l->radius > 0.0f)
        look_along(l, at, &b, o, axes, 1, met, mixed);
    else
        look_along(l, at, &b, o, axes, 0, met, mixed);
    float all = total(met, at->points) * seen, grazing = total(mixed, at->points) * seen;
    for (int c = 0; c < 3; c++)
        p->total[c][i] += (p->specular[c][i] * (all - grazing) + grazing) * l->colour[c];
}

/* Adds an area light. field: casts shadows, or NULL. ran: bit 0 where the light was integrated,
   bit 1 where relief hides a part of it. */
WIDE void matcap_relight_area(const Pixels *p, const AreaLight *l, const Field *field,
                              const Lattice *at, int32_t adaptive, uint8_t *ran) {
    Seen s;
    for (int64_t i = 0; i < p->count; i++) {
        int sets, which = p->facing[i] ? chosen(l, p, i, adaptive, &sets) : 0;
        if (!which) continue;
        float shadow[CELLS], squared = 0.0f, seen = 0.0f;
        int parted = 0;
        ran[i] |= 1;
        if (field) {
            int clear = parts_lit(l, p, i, field, &s, shadow);
            parted = sets || !clear;
            ran[i] |= clear ? 0 : 2;
        }
        for (int k = 0; k < 3; k++)
            squared += (l->place[k] - p->point[k][i]) * (l->place[k] - p->point[k][i]);
        float fading = l->even > 0.0f ? squared * l->even : 1.0f;
        int lobe = l->specular && which != SAMPLED;
        int fine = which < sets ? sets : which;
        integrate(l, parted ? &l->parted[fine] : &l->plain[which], p, i, parted ? shadow : NULL,
                  lobe, fading, &s);
        for (int c = 0; c < CELLS && parted; c++) seen += shadow[c] / CELLS;
        if (l->specular && which == SAMPLED) sampled(l, at, p, i, parted ? seen : 1.0f);
    }
}
