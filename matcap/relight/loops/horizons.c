/* Horizon maps and one-bounce transfer: see horizons.py. Works on groups of LANES adjacent texels
   of a row, whose neighbours are adjacent as well. */

#include "loops.h"

typedef struct {
    const float *padded; /* heights in texels, padded by `reach` */
    const float *lit;    /* CHANNELS of reflected light a texel, padded likewise, or NULL */
    const float *cosine, *sine;     /* of each azimuth */
    const int32_t *offset;          /* azimuths x steps: index offsets */
    const float *inverse;           /* azimuths x steps: 1 / distance */
    const int32_t *end;             /* parts: one after the last step of each */
    const float *nearest;           /* parts: 1 / least distance */
    int32_t steps, parts, columns, reach, width; /* columns: of the texture; width: padded */
    float highest;                  /* largest height */
} Walk;

/* Kept as a loop, which GCC vectorises; unrolled it becomes eight scalar sums. */
#if defined(__GNUC__) && !defined(__clang__)
#define EACH_LANE(k) _Pragma("GCC unroll 1") for (int k = 0; k < LANES; k++)
#else
#define EACH_LANE(k) for (int k = 0; k < LANES; k++)
#endif

/* Channels added at once, whole vectors: those beyond CHANNELS are of the next texel, and unused. */
enum { SUMS = 2 * LANES };

typedef struct {
    float own[LANES], nz[LANES];
    float level[AZIMUTHS][LANES], side[AZIMUTHS][LANES], weight[AZIMUTHS][LANES];
    float faced[LANES], sum[LANES][SUMS];
} Group;

/* Integral of (n.w) cos(e) over elevations e from 0 to atan(tangent), at one azimuth. */
INLINE float strip(float tangent, float side, float nz) {
    float squared = tangent * tangent, share = 1.0f / (1.0f + squared);
    return 0.5f * (side * (arctangent(tangent) + tangent * share) + nz * squared * share);
}

/* Initial horizon along each azimuth: the texel's own slope. */
INLINE void begin(const Walk *w, const float *at, Group *g) {
    EACH_LANE(k) g->faced[k] = 0.0f;
    for (int k = 0; k < LANES; k++)
        for (int c = 0; c < SUMS; c++) g->sum[k][c] = 0.0f;
    for (int a = 0; a < AZIMUTHS; a++)
        EACH_LANE(k) {
            float sx = 0.5f * (at[k + 1] - at[k - 1]);
            float sy = 0.5f * (at[k - w->width] - at[k + w->width]);
            float nz = 1.0f / sqrtf(1.0f + sx * sx + sy * sy);
            float level = w->cosine[a] * sx + w->sine[a] * sy;
            g->own[k] = at[k], g->nz[k] = nz;
            g->level[a][k] = level, g->side[a][k] = -level * nz;
            float weight = strip(level, -level * nz, nz);
            g->weight[a][k] = weight, g->faced[k] -= weight;
        }
}

/* Raises an azimuth's horizons by the steps of a part; returns whether any rose. last, unless NULL:
   offset of the step that raised each. */
INLINE int rose(const Walk *w, int part, int a, const float *at, Group *g, int32_t *last) {
    const int32_t *offset = w->offset + a * w->steps;
    const float *inverse = w->inverse + a * w->steps;
    float level[LANES], most[LANES] = {0};
    int changed = 0;
    EACH_LANE(k) level[k] = g->level[a][k];
    int first = part ? w->end[part - 1] : 0;
    for (int step = first; step < w->end[part]; step++) {
        const float *there = at + offset[step];
        float near = inverse[step];
        /* Distances grow along an azimuth: where no texel is high enough, none farther is. */
        if (step > first && (step - first) % 4 == 0) {
            int could = 0;
            EACH_LANE(k) could |= (w->highest - g->own[k]) * near > level[k];
            if (!could) break;
        }
        EACH_LANE(k) {
            float rise = (there[k] - g->own[k]) * near;
            if (last) {
                last[k] = rise - level[k] > most[k] ? offset[step] : last[k];
                most[k] = larger(most[k], rise - level[k]);
            }
            level[k] = rise > level[k] ? rise : level[k];
        }
    }
    EACH_LANE(k) changed |= level[k] > g->level[a][k];
    EACH_LANE(k) g->level[a][k] = level[k];
    return changed;
}

/* Adds the light of the strips between old and new horizons, from the texels that raised them. */
INLINE void receive(const Walk *w, int a, int64_t spot, const int32_t *last, Group *g) {
    float share[LANES];
    EACH_LANE(k) {
        float higher = strip(g->level[a][k], g->side[a][k], g->nz[k]);
        share[k] = higher - g->weight[a][k];
        g->weight[a][k] = higher;
    }
    for (int k = 0; k < LANES; k++) {
        const float *lit = w->lit + CHANNELS * (spot + k + last[k]);
        float *restrict sum = g->sum[k];
        for (int c = 0; c < SUMS; c++) sum[c] += share[k] * lit[c];
    }
}

/* Walks outwards from a group until nothing farther could rise above its horizons. */
INLINE void walk(const Walk *w, const float *at, int64_t spot, Group *g) {
    int32_t last[LANES] = {0};
    for (int part = 0, more = 1; part < w->parts && more; part++) {
        more = 0;
        for (int a = 0; a < AZIMUTHS; a++) {
            int could = 0;
            EACH_LANE(k)
                could |= (w->highest - g->own[k]) * w->nearest[part] > g->level[a][k];
            if (!could) continue;
            more = 1;
            if (!w->lit)
                rose(w, part, a, at, g, NULL);
            else if (rose(w, part, a, at, g, last))
                receive(w, a, spot, last, g);
        }
    }
}

/* Fills, for groups of texels, horizons (AZIMUTHS a texel, unless NULL), view factors (2), and, if
   w->lit, transfer vectors (CHANNELS). starts: the first texel of each group. */
WIDE void matcap_relight_walk(const Walk *w, int64_t count, const int32_t *starts,
                              float *tangents, float *open, float *transfer) {
    Group g;
    for (int64_t n = 0; n < count; n++) {
        int64_t i = starts[n], row = i / w->columns, column = i % w->columns;
        int64_t spot = (row + w->reach) * w->width + column + w->reach;
        float seen[LANES] = {0};
        begin(w, w->padded + spot, &g);
        walk(w, w->padded + spot, spot, &g);
        for (int a = 0; a < AZIMUTHS; a++)
            EACH_LANE(k) {
                float side = g.side[a][k], nz = g.nz[k], level = g.level[a][k];
                float above = strip(level, side, nz);
                g.faced[k] += above;
                seen[k] += side * (0.5f * HALF_PI) + nz * 0.5f - (level > 0.0f ? above : 0.0f);
            }
        for (int k = 0; k < LANES && column + k < w->columns; k++) {
            int64_t to = i + k;
            /* Irradiance of uniform radiance 1 over that of the same normal without relief. */
            float part = seen[k] * (4.0f / AZIMUTHS) / (1.0f + g.nz[k]);
            open[2 * to] = part < 0.0f ? 0.0f : part > 1.0f ? 1.0f : part;
            open[2 * to + 1] = g.faced[k] * (2.0f / AZIMUTHS);
            for (int a = 0; a < AZIMUTHS && tangents; a++)
                tangents[to * AZIMUTHS + a] = g.level[a][k];
            for (int c = 0; c < CHANNELS && w->lit; c++)
                transfer[to * CHANNELS + c] = g.sum[k][c];
        }
    }
}
