/* Lookups between texels: filtered maps, transfer vectors, and which horizons are still missing. */

#include "loops.h"

typedef struct {
    const float *rows;     /* texels of all levels, `channels` floats each */
    const int64_t *starts; /* index of each level's first texel */
    const int32_t *widths, *heights;
    int32_t channels, levels;
} Texels;

enum { MOST = 16 }; /* channels */

/* Indices and bilinear weights of the four texels around a place; the texture repeats. */
INLINE void around(int32_t width, int32_t height, double column, double row, int64_t at[4],
                   float weight[4]) {
    double left = floor(column), above = floor(row);
    float fx = (float)(column - left), fy = (float)(row - above);
    int32_t x0 = wrapped((int64_t)left, width), y0 = wrapped((int64_t)above, height);
    int32_t x1 = x0 + 1 == width ? 0 : x0 + 1, y1 = y0 + 1 == height ? 0 : y0 + 1;
    at[0] = (int64_t)y0 * width + x0, at[1] = (int64_t)y0 * width + x1;
    at[2] = (int64_t)y1 * width + x0, at[3] = (int64_t)y1 * width + x1;
    weight[0] = (1.0f - fx) * (1.0f - fy), weight[1] = fx * (1.0f - fy);
    weight[2] = (1.0f - fx) * fy, weight[3] = fx * fy;
}

/* Adds `share` times the bilinear value of one mip level. */
INLINE void level(const Texels *t, int index, double column, double row, float share,
                  float sum[MOST]) {
    int64_t at[4];
    float weight[4];
    int32_t width = t->widths[index], height = t->heights[index], channels = t->channels;
    if (index) {
        column = (column + 0.5) * ((double)width / t->widths[0]) - 0.5;
        row = (row + 0.5) * ((double)height / t->heights[0]) - 0.5;
    }
    around(width, height, column, row, at, weight);
    for (int k = 0; k < 4; k++) {
        const float *texel = t->rows + (t->starts[index] + at[k]) * channels;
        float part = share * weight[k];
        for (int c = 0; c < channels; c++) sum[c] += part * texel[c];
    }
}

/* (channels, count) trilinear values, for footprints of `wide` texels; NULL: bilinear, level 0. */
WIDE void matcap_relight_read(const Texels *t, int64_t count, const double *column,
                              const double *row, const float *wide, float *found) {
    int highest = t->levels > 2 ? t->levels - 2 : 0;
    for (int64_t i = 0; i < count; i++) {
        float sum[MOST] = {0}, share = 0.0f;
        int low = 0;
        if (wide && wide[i] > 1.0f) {
            float depth = smaller(log2f(wide[i]), t->levels - 1.0f);
            low = (int)depth < highest ? (int)depth : highest;
            share = depth - (float)low;
        }
        level(t, low, column[i], row[i], 1.0f - share, sum);
        if (share > 0.0f) level(t, low + 1, column[i], row[i], share, sum);
        for (int c = 0; c < t->channels; c++) found[c * count + i] = sum[c];
    }
}

/* Groups of LANES texels of a row that lookups at places need and that are not known yet, each
   once, by its first texel; returns their number. known, marks: by first texel; marks holds the
   number of the last call that listed the group. */
int64_t matcap_relight_unknown(int32_t width, int32_t height, const uint8_t *known,
                               uint32_t *marks, uint32_t call, int64_t count,
                               const int32_t *which, const double *column, const double *row,
                               int32_t *found) {
    int64_t size = 0;
    for (int64_t k = 0; k < count; k++) {
        int64_t i = which ? which[k] : k, at[4];
        float weight[4];
        around(width, height, column[i], row[i], at, weight);
        for (int c = 0; c < 4; c++) {
            int64_t first = at[c] - at[c] % width % LANES;
            if (!known[first] && marks[first] != call) {
                marks[first] = call;
                found[size++] = (int32_t)first;
            }
        }
    }
    return size;
}

/* Adds one bounce to the pixels `which`: albedo / pi times max(transfer . vector irradiance, 0). */
WIDE void matcap_relight_bounce(const Pixels *p, int32_t width, int32_t height,
                                const float *transfer, int64_t count, const int32_t *which) {
    for (int64_t k = 0; k < count; k++) {
        int64_t i = which[k], at[4];
        float weight[4], sum[CHANNELS] = {0};
        around(width, height, p->column[i], p->row[i], at, weight);
        for (int n = 0; n < 4; n++)
            for (int c = 0; c < CHANNELS; c++) sum[c] += weight[n] * transfer[at[n] * CHANNELS + c];
        for (int c = 0; c < 3; c++) {
            float arriving = 0.0f;
            for (int axis = 0; axis < 3; axis++)
                arriving += sum[3 * c + axis] * p->vector[3 * c + axis][i];
            p->total[c][i] += p->diffuse[c][i] * INVERSE_PI * larger(arriving, 0.0f);
        }
    }
}
