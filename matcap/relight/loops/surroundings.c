/* Specular reflection of environments: visible normals [dupuy2023] times prefiltered radiance. */

#include "loops.h"

typedef struct {
    const float *atlas, *tops, *sides; /* levels, their first rows and sides: see environment_map.py */
    int32_t width, levels;             /* of the atlas */
    float finest; /* side of a texel of level 0, radians */
    float blur;   /* side of the averaged solid angle over that of a sample */
    float mean[3];
} Environment;

/* Radiance along a unit vector of the scene, from the level with texels of about `wide` radians. */
INLINE void radiance(const Environment *s, const float d[3], float wide, float light[3]) {
    float u = fabsf(d[0]), v = fabsf(d[1]), inverse = 1.0f / (u + v + fabsf(d[2]));
    u *= inverse, v *= inverse;
    float x = d[2] < 0.0f ? 1.0f - v : u, y = d[2] < 0.0f ? 1.0f - u : v;
    int exponent;
    frexpf(wide * (1.41421356237f / s->finest), &exponent);
    int level = exponent - 1;
    level = level < 0 ? 0 : level >= s->levels ? s->levels - 1 : level;
    /* Texel i is centred at i + 0.5, one further for the border. */
    float half = s->sides[level] * 0.5f;
    float column = (copysignf(x, d[0]) + 1.0f) * half + 0.5f;
    float row = (copysignf(y, d[1]) + 1.0f) * half + s->tops[level] + 0.5f;
    int left = (int)column, above = (int)row;
    float fx = column - (float)left, fy = row - (float)above;
    const float *at = s->atlas + 3 * ((int64_t)above * s->width + left), *below = at + 3 * s->width;
    for (int c = 0; c < 3; c++) {
        float upper = at[c] + fx * (at[c + 3] - at[c]);
        light[c] = upper + fy * (below[c] + fx * (below[c + 3] - below[c]) - upper);
    }
}

/* (3, count) radiance of many directions. */
void matcap_relight_radiance(const Environment *s, int64_t count, const float *x, const float *y,
                             const float *z, const float *wide, float *found) {
    for (int64_t i = 0; i < count; i++) {
        float d[3] = {x[i], y[i], z[i]}, light[3];
        radiance(s, d, wide[i], light);
        for (int c = 0; c < 3; c++) found[c * count + i] = light[c];
    }
}

/* Reflection of (radiance - mean) in the pixels `which`, (6, count): red, green, blue of the
   scale on F0, then of the bias. */
WIDE void matcap_relight_sky(const Pixels *p, const Lattice *at, const Environment *s,
                             const Horizon *h, int64_t count, const int32_t *which, float *sums) {
    for (int64_t n = 0; n < count; n++) {
        int64_t i = which[n];
        Lobe b = lobe_of(p, i);
        float plain[3] = {0}, mixed[3] = {0}, alpha = p->alpha[i];
        float size = sqrtf((b.nv + b.view) * (4.0f * HALF_PI)) / alpha * s->blur;
        const float *tangents = NULL;
        if (h->tangents) tangents = texel_horizon(h, p, i);
        for (int k = 0; k < at->points; k++) {
            float d[3], light[3], fresnel, spread, share = at->weight[k];
            float weight = mirrored(&b, at->u[k], at->cosine[k], at->sine[k], d, &fresnel, &spread);
            weight *= share;
            if (weight == 0.0f) continue;
            int clear = d[2] > 0.0f && (!tangents || above_horizon(tangents, d[0], d[1], d[2]));
            float x = d[0], y = d[1], z = d[2];
            for (int c = 0; c < 3 && p->frame[0]; c++)
                d[c] = x * p->frame[c][i] + y * p->frame[3 + c][i] + z * p->frame[6 + c][i];
            if (clear) radiance(s, d, spread * size * sqrtf(share), light);
            for (int c = 0; c < 3; c++) {
                float part = ((clear ? light[c] : 0.0f) - s->mean[c]) * weight;
                mixed[c] += part * fresnel, plain[c] += part - part * fresnel;
            }
        }
        for (int c = 0; c < 3; c++) {
            sums[c * count + n] = plain[c];
            sums[(3 + c) * count + n] = mixed[c];
        }
    }
}

/* Flags the samples whose mirrored direction is above the shading normal's horizon, but has z below
   `sine`: only these can be hidden. */
INLINE void look_low(const Lobe *b, const Lattice *at, float sine, int32_t low[POINTS]) {
    float vx = b->vs[0], vy = b->vs[1], vz = b->vs[2], stretch = 2.0f * b->nv / vz;
    float limit = sine + b->v[2], least = b->nv * (1.0f - 1e-5f);
    for (int k = 0; k < at->points; k++) {
        float z = (1.0f + vz) * (1.0f - at->u[k]) - vz, ring = sqrtf(larger(1.0f - z * z, 0.0f));
        float x = ring * at->cosine[k], y = ring * at->sine[k], tilt = z + vz;
        float half = b->m[2] + b->s[2] * x + b->t[2] * y + b->n[2] * z;
        float apart = x * vx + y * vy + 1.0f + z * vz;
        float length = tilt * tilt * b->flat + apart * (2.0f * b->squared);
        float reach = apart * stretch / larger(length, 1e-20f);
        low[k] = (half * reach - limit <= 0.0f) & (tilt * reach > least);
    }
}

/* Reflection of uniform radiance 1 that surface and relief hide, (2, count): scale on F0, and bias.
   Samples above the pixel's highest horizon are skipped. */
WIDE void matcap_relight_hidden(const Pixels *p, const Lattice *at, const Horizon *h,
                                int64_t count, const int32_t *which, float *sums) {
    int32_t low[POINTS];
    for (int64_t n = 0; n < count; n++) {
        int64_t i = which[n];
        Lobe b = lobe_of(p, i);
        const float *tangents = NULL;
        float steepest = 0.0f, plain = 0.0f, mixed = 0.0f;
        if (h->tangents) {
            tangents = texel_horizon(h, p, i);
            for (int a = 0; a < AZIMUTHS; a++) steepest = larger(steepest, tangents[a]);
        }
        float sine = h->adaptive ? steepest / sqrtf(1.0f + steepest * steepest) + 1e-5f : 2.0f;
        look_low(&b, at, sine, low);
        for (int k = 0; k < at->points; k++) {
            if (!low[k] || at->weight[k] == 0.0f) continue;
            float d[3], fresnel, spread;
            float weight = mirrored(&b, at->u[k], at->cosine[k], at->sine[k], d, &fresnel, &spread);
            if (d[2] > 0.0f && (!tangents || above_horizon(tangents, d[0], d[1], d[2]))) continue;
            weight *= at->weight[k];
            mixed += weight * fresnel, plain += weight - weight * fresnel;
        }
        sums[n] = plain, sums[count + n] = mixed;
    }
}
