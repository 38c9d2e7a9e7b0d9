/* The field by example: correction of its places, in integers, and blending of its maps, in floats
   summed in a fixed order (built without contraction); and the comparison of blocks for inpainting.
   tests/example/plain_loops.py computes the same bits in NumPy. */

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#if defined(__x86_64__) && defined(__GNUC__)
#define MATCAP_AVX2 /* if the processor has it, at run time */
#include <immintrin.h>
#elif defined(__SSE2__)
#include <emmintrin.h>
#endif

/* As in relight/loops/loops.h: also compiled for AVX2, where the loader can choose. No
   multiply-add is fused, so that the bits are the same. */
#if defined(__x86_64__) && defined(__linux__) && defined(__GNUC__) && !defined(__clang__)
#define WIDE __attribute__((target_clones("avx2", "default")))
#else
#define WIDE
#endif
#if defined(__GNUC__)
#define INLINE static inline __attribute__((always_inline))
#define PREFETCH(address) __builtin_prefetch(address)
#else
#define INLINE static inline
#define PREFETCH(address) ((void)(address))
#endif
#if defined(__GNUC__) && !defined(__clang__)
#define LOOP _Pragma("GCC unroll 1") /* kept a loop, gcc makes vectors of it */
#else
#define LOOP
#endif

enum {
    /* As in candidates.py, index.py and plain_loops.py. */
    DIMENSIONS = 8,
    PLANES = 8,
    SIDE = 5,
    LARGEST = 700,
    DIAGONALS = 4,
    AROUND = 9,
    REACH = 2,
    PHASE_SHIFT = 2,
    COST_BITS = 2,
    STRIP = 512, /* places of a row that are tested together */
};

typedef struct {
    int16_t x, y;
} Place;

/* Version of results and arguments, as in library.py: a library of another version is not used. */
enum { FORM = 6 };

int32_t matcap_form(void) { return FORM; }

typedef struct {
    uint16_t one, two;
} Phase;

typedef struct {
    const int16_t *appearance; /* rows x columns x DIMENSIONS */
    const int32_t *cost;       /* of squares of 2^COST_BITS texels */
    const Place *similar;      /* similar_rows x similar_columns */
    const Phase *phases;       /* rows x columns, or NULL */
    int32_t columns, similar_columns, cost_columns;
    int32_t bits, similar_bits, similar_shift;
    int32_t spacing;
    int32_t left, top, right, bottom;
} Level;

static const int DIAGONAL[DIAGONALS][2] = {{-1, -1}, {-1, 1}, {1, -1}, {1, 1}};
static const int NEAR[AROUND][2] = {{0, 0},  {-1, -1}, {-1, 0}, {-1, 1}, {0, -1},
                                    {0, 1},  {1, -1},  {1, 0},  {1, 1}};
static const int SUBPASS[4][2] = {{0, 0}, {1, 1}, {0, 1}, {1, 0}};

static const int16_t *appearance_at(const Level *l, int32_t x, int32_t y) {
    return l->appearance + DIMENSIONS * ((ptrdiff_t)(y >> l->bits) * l->columns + (x >> l->bits));
}

static Place at(const Place *places, ptrdiff_t columns, int y, int x) {
    return places[y * columns + x];
}

static int same(Place a, Place b) { return a.x == b.x && a.y == b.y; }

static int inside(const Level *l, int32_t x, int32_t y) {
    return x >= l->left && x <= l->right && y >= l->top && y <= l->bottom;
}

/* Sum over dimensions of (3 found - wanted)^2; `wanted` is the sum of three appearance vectors. */
static int32_t squared_difference(const int16_t *found, const int16_t *wanted) {
#if defined(__SSE2__)
    const __m128i f = _mm_loadu_si128((const __m128i *)found);
    const __m128i w = _mm_loadu_si128((const __m128i *)wanted);
    const __m128i difference = _mm_sub_epi16(_mm_add_epi16(f, _mm_add_epi16(f, f)), w);
    __m128i sum = _mm_madd_epi16(difference, difference);
    sum = _mm_add_epi32(sum, _mm_shuffle_epi32(sum, _MM_SHUFFLE(1, 0, 3, 2)));
    sum = _mm_add_epi32(sum, _mm_shuffle_epi32(sum, _MM_SHUFFLE(2, 3, 0, 1)));
    return _mm_cvtsi128_si32(sum);
#else
    int32_t sum = 0;
    for (int d = 0; d < DIMENSIONS; d++) {
        int16_t difference = (int16_t)(3 * found[d] - wanted[d]);
        sum += (int32_t)difference * difference;
    }
    return sum;
#endif
}

/* Cost of a candidate place, its mismatch times 2^shift; stops early once it is at least `most`,
   which is below 2^30 where the shift is 2: no sum overflows. */
static int32_t cost_of(const Level *l, int32_t x, int32_t y, const int16_t *wanted,
                       const Phase *ordered, int32_t shift, int32_t most) {
    int32_t cost = 0;
    for (int k = 0; k < DIAGONALS; k++) {
        const int16_t *found =
            appearance_at(l, x + DIAGONAL[k][1] * l->spacing, y + DIAGONAL[k][0] * l->spacing);
        cost += squared_difference(found, wanted + k * DIMENSIONS) << shift;
        if (cost >= most) return cost;
    }
    if (l->phases) {
        const ptrdiff_t place = (ptrdiff_t)(y >> l->bits) * l->columns + (x >> l->bits);
        const int32_t one = (int16_t)(l->phases[place].one - ordered->one) >> PHASE_SHIFT;
        const int32_t two = (int16_t)(l->phases[place].two - ordered->two) >> PHASE_SHIFT;
        cost += one * one + two * two;
    }
    return cost + l->cost[(ptrdiff_t)(y >> COST_BITS) * l->cost_columns + (x >> COST_BITS)];
}

/* Prefetch what the cost of a place will read. */
static void expect(const Level *l, Place p) {
    for (int y = -1; y <= 1; y += 2)
        PREFETCH(appearance_at(l, p.x - l->spacing, p.y + y * l->spacing));
}

/* Append a place to the candidates, unless it is among them; returns their number. */
static int added(Place *tried, int count, Place p) {
    for (int k = 0; k < count; k++)
        if (same(tried[k], p)) return count;
    tried[count] = p;
    return count + 1;
}

static Place corrected(const Level *l, const Place *here, ptrdiff_t columns,
                       const Phase *ordered) {
    const int step = l->spacing;
    Place tried[2 * AROUND], near[AROUND];
    int count = 0;
    for (int k = 0; k < AROUND; k++) {
        Place p = at(here, columns, NEAR[k][0], NEAR[k][1]);
        near[k].x = (int16_t)(p.x - NEAR[k][1] * step);
        near[k].y = (int16_t)(p.y - NEAR[k][0] * step);
        if (inside(l, near[k].x, near[k].y)) count = added(tried, count, near[k]);
    }
    const int continued = count, mask = (1 << l->similar_bits) - 1;
    for (int k = 0; k < continued; k++) {
        const Place c = tried[k];
        Place s = l->similar[(ptrdiff_t)(c.y >> l->similar_bits) * l->similar_columns +
                             (c.x >> l->similar_bits)];
        s.x = (int16_t)(s.x + (c.x & mask));
        s.y = (int16_t)(s.y + (c.y & mask));
        if (inside(l, s.x, s.y)) count = added(tried, count, s);
    }
    for (int k = 0; k < count; k++) expect(l, tried[k]);

    int16_t wanted[DIAGONALS * DIMENSIONS];
    for (int k = 0; k < DIAGONALS; k++) {
        const int y = DIAGONAL[k][0], x = DIAGONAL[k][1];
        Place one = at(here, columns, y, x);
        Place two = at(here, columns, 2 * y, x);
        Place three = at(here, columns, y, 2 * x);
        const int16_t *a = appearance_at(l, one.x, one.y);
        const int16_t *b = appearance_at(l, two.x, two.y - y * step);
        const int16_t *c = appearance_at(l, three.x - x * step, three.y);
        for (int d = 0; d < DIMENSIONS; d++)
            wanted[k * DIMENSIONS + d] = (int16_t)(a[d] + b[d] + c[d]);
    }

    Place best = near[0];
    int32_t best_cost = INT32_MAX;
    for (int k = 0; k < count; k++) {
        const int32_t shift = k >= continued ? l->similar_shift : 0;
        const int32_t cost = cost_of(l, tried[k].x, tried[k].y, wanted, ordered, shift, best_cost);
        if (cost < best_cost) {
            best_cost = cost;
            best = tried[k];
        }
    }
    return best;
}

/* found: for `count` places of a row, 0 if all eight neighbours continue the place. Coordinates are
   not negative, so that both are compared as one 32-bit number. */
static void unsettled(const Place *row, ptrdiff_t columns, int32_t step, int32_t count,
                      int32_t *found) {
    memset(found, 0, (size_t)count * sizeof(int32_t));
    for (int k = 1; k < AROUND; k++) {
        const int32_t y = NEAR[k][0], x = NEAR[k][1];
        const uint32_t apart = (uint32_t)x * (uint32_t)step + (((uint32_t)y * (uint32_t)step) << 16);
        const Place *other = row + y * columns + x;
        for (int32_t c = 0; c < count; c++) {
            uint32_t here, there;
            memcpy(&here, row + c, sizeof here);
            memcpy(&there, other + c, sizeof there);
            found[c] |= (int32_t)((there - here) ^ apart);
        }
    }
}

/* correction.correct: places and scratch are rows x columns. The outermost 8 * passes rows and
   columns of the result are undefined. */
void matcap_correct(const Level *l, Place *places, Place *scratch, int32_t columns, int32_t rows,
                    const uint8_t *odd_columns, const uint8_t *odd_rows, int32_t passes,
                    const Phase *phases) {
    int32_t border = 0;
    for (int32_t s = 0; s < 4 * passes; s++) {
        memcpy(scratch, places, (size_t)rows * (size_t)columns * sizeof(Place));
        border += REACH;
        for (int32_t y = border; y < rows - border; y++) {
            if (odd_rows[y] != SUBPASS[s % 4][0]) continue;
            for (int32_t left = border; left < columns - border; left += STRIP) {
                const ptrdiff_t first = (ptrdiff_t)y * columns + left;
                const int32_t rest = columns - border - left;
                const int32_t count = rest < STRIP ? rest : STRIP;
                int32_t open[STRIP];
                unsettled(scratch + first, columns, l->spacing, count, open);
                for (int32_t x = 0; x < count; x++)
                    if (open[x] && odd_columns[left + x] == SUBPASS[s % 4][1])
                        places[first + x] = corrected(l, scratch + first + x, columns,
                                                      phases ? phases + first + x : NULL);
            }
        }
    }
}

/* Products of a neighbourhood's features with each dimension's weights, in exact integers. */
static void project(const int16_t *here, ptrdiff_t row, ptrdiff_t step, const int16_t *weights,
                    int32_t *sums) {
    for (int d = 0; d < DIMENSIONS; d++) {
        sums[d] = 0;
        for (int tap = 0; tap < SIDE * SIDE; tap++) {
            const int16_t *at = here + (tap / SIDE) * row + (tap % SIDE) * step;
            const int16_t *w = weights + (d * SIDE * SIDE + tap) * PLANES;
            for (int k = 0; k < PLANES; k++) sums[d] += (int32_t)at[k] * w[k];
        }
    }
}

#if defined(MATCAP_AVX2)
/* project for a place and the next one in the row: (2, DIMENSIONS) sums. */
__attribute__((target("avx2"))) static void project_two(const int16_t *here, ptrdiff_t row,
                                                        ptrdiff_t step, const int16_t *weights,
                                                        int32_t *sums) {
    __m256i total[DIMENSIONS];
    for (int d = 0; d < DIMENSIONS; d++) total[d] = _mm256_setzero_si256();
    for (int y = 0; y < SIDE; y++) {
        for (int x = 0; x < SIDE; x++) {
            const int16_t *at = here + y * row + x * step;
            const __m256i features = _mm256_loadu_si256((const __m256i *)at);
            for (int d = 0; d < DIMENSIONS; d++) {
                const int16_t *w = weights + ((d * SIDE + y) * SIDE + x) * PLANES;
                const __m256i weight =
                    _mm256_broadcastsi128_si256(_mm_loadu_si128((const __m128i *)w));
                total[d] = _mm256_add_epi32(total[d], _mm256_madd_epi16(features, weight));
            }
        }
    }
    for (int d = 0; d < DIMENSIONS; d += 4) {
        const __m256i one = _mm256_hadd_epi32(total[d], total[d + 1]);
        const __m256i two = _mm256_hadd_epi32(total[d + 2], total[d + 3]);
        const __m256i all = _mm256_hadd_epi32(one, two);
        _mm_storeu_si128((__m128i *)(sums + d), _mm256_castsi256_si128(all));
        _mm_storeu_si128((__m128i *)(sums + DIMENSIONS + d), _mm256_extracti128_si256(all, 1));
    }
}

static int two_at_once(void) { return __builtin_cpu_supports("avx2"); }
#else
static void project_two(const int16_t *here, ptrdiff_t row, ptrdiff_t step, const int16_t *weights,
                        int32_t *sums) {
    project(here, row, step, weights, sums);
    project(here + PLANES, row, step, weights, sums + DIMENSIONS);
}

static int two_at_once(void) { return 0; }
#endif

/* appearance.project: features (rows + 4 step) x (columns + 4 step) x PLANES, weights DIMENSIONS x
   SIDE x SIDE x PLANES, found rows x columns x DIMENSIONS. */
void matcap_project(const int16_t *features, const int16_t *weights, int32_t step, int32_t shift,
                    int32_t columns, int32_t rows, int16_t *found) {
    const ptrdiff_t row = (ptrdiff_t)(columns + (SIDE - 1) * step) * PLANES;
    const int fast = two_at_once();
    for (int32_t y = 0; y < rows; y++) {
        for (int32_t x = 0, count; x < columns; x += count) {
            int32_t sums[2 * DIMENSIONS];
            count = fast && x + 1 < columns ? 2 : 1;
            (count == 2 ? project_two : project)(features + y * row + (ptrdiff_t)x * PLANES,
                                                 step * row, (ptrdiff_t)step * PLANES, weights,
                                                 sums);
            int16_t *to = found + ((ptrdiff_t)y * columns + x) * DIMENSIONS;
            for (int d = 0; d < count * DIMENSIONS; d++) {
                const int32_t value = sums[d] >> shift;
                to[d] = (int16_t)(value > LARGEST ? LARGEST : value < -LARGEST ? -LARGEST : value);
            }
        }
    }
}

/* Blending; equations in blend.py. */

enum {
    CHANNELS = 8, /* of a band: stacked maps, then zeros */
    TAPS = 4,     /* of the low-pass filter, on either side */
    NODES = 3,    /* nodes along an axis that vote for a texel */
    VOTES = NODES * NODES,
};

/* Binomial coefficients of order 8. */
static const float SMOOTHING[TAPS + 1] = {70.0f / 256.0f, 56.0f / 256.0f, 28.0f / 256.0f,
                                          8.0f / 256.0f, 1.0f / 256.0f};

static ptrdiff_t within(ptrdiff_t at, ptrdiff_t count) {
    return at < 0 ? 0 : at >= count ? count - 1 : at;
}

/* Low-pass filter along one axis, whose texels are `apart` numbers apart; borders repeat. */
INLINE void smooth(const float *from, float *to, ptrdiff_t count, ptrdiff_t apart) {
    for (ptrdiff_t i = 0; i < count; i++) {
        const float *here = from + i * apart;
        for (int d = 0; d < CHANNELS; d++) to[i * apart + d] = here[d] * SMOOTHING[0];
        for (int tap = 1; tap <= TAPS; tap++) {
            const float *before = from + within(i - tap, count) * apart;
            const float *after = from + within(i + tap, count) * apart;
            for (int d = 0; d < CHANNELS; d++)
                to[i * apart + d] += (before[d] + after[d]) * SMOOTHING[tap];
        }
    }
}

/* values, scratch: rows x columns x CHANNELS; values are smoothed along both axes. */
WIDE void matcap_smooth(float *values, float *scratch, int32_t columns, int32_t rows) {
    const ptrdiff_t row = (ptrdiff_t)columns * CHANNELS;
    for (int32_t y = 0; y < rows; y++) smooth(values + y * row, scratch + y * row, columns, CHANNELS);
    for (int32_t y = 0; y < rows; y++) {
        float *to = values + y * row;
        for (ptrdiff_t i = 0; i < row; i++) to[i] = scratch[y * row + i] * SMOOTHING[0];
        for (int tap = 1; tap <= TAPS; tap++) {
            const float *above = scratch + within(y - tap, rows) * row;
            const float *below = scratch + within(y + tap, rows) * row;
            for (ptrdiff_t i = 0; i < row; i++) to[i] += (above[i] + below[i]) * SMOOTHING[tap];
        }
    }
}

/* A vote: x, y of the exemplar for the area's texel (0, 0). */
typedef struct {
    int32_t x, y;
} Offset;

typedef struct {
    const int16_t *values;                      /* rows x columns x CHANNELS */
    const float *scale;                         /* CHANNELS: of the values */
    const float *kept;                          /* CHANNELS: 1 if the gain g applies, else 0 */
    const Offset *offsets;                      /* votes: node rows x node_columns */
    const int32_t *first_column, *first_row;    /* first of a texel's NODES nodes */
    const float *column_weights, *row_weights;  /* NODES for each texel */
    int32_t columns, rows, node_columns, shift; /* shift: from half texels to the band's grid */
    float correlation;                          /* r of blend.py */
} Band;

typedef struct {
    const float *const *planes; /* channels of rows x columns: the exemplar's maps */
    const Place *places;        /* of squares of 2^bits texels */
    int32_t channels, columns, place_columns, bits;
    int32_t left, top; /* texels from the first place to the first texel */
} Exemplar;

typedef struct {
    float of[CHANNELS];
} Texel;

INLINE void read_band(const Band *b, int32_t x, int32_t y, int32_t half, Texel *found) {
    const int32_t mask = (1 << b->shift) - 1;
    const int32_t right = (b->columns - 1) << b->shift, bottom = (b->rows - 1) << b->shift;
    x = 2 * x - half;
    y = 2 * y - half;
    x = x < 0 ? 0 : x > right ? right : x;
    y = y < 0 ? 0 : y > bottom ? bottom : y;
    const int16_t *here =
        b->values + CHANNELS * ((ptrdiff_t)(y >> b->shift) * b->columns + (x >> b->shift));
    if (!((x | y) & mask)) {
        LOOP
        for (int d = 0; d < CHANNELS; d++) found->of[d] = (float)here[d];
        return;
    }
    const int16_t *below = here + (y < bottom ? CHANNELS * (ptrdiff_t)b->columns : 0);
    const ptrdiff_t next = x < right ? CHANNELS : 0;
    const float unit = 1.0f / (float)(mask + 1);
    const float across = (float)(x & mask) * unit, down = (float)(y & mask) * unit;
    LOOP
    for (int d = 0; d < CHANNELS; d++) {
        const float one = (float)here[d], two = (float)below[d];
        const float upper = one + ((float)here[next + d] - one) * across;
        const float lower = two + ((float)below[next + d] - two) * across;
        found->of[d] = upper + (lower - upper) * down;
    }
}

/* The distinct votes of a texel's nodes; and for each, by column of nodes, the sum of the row weights
   of the nodes that cast it. */
static int differing(const Offset *first, ptrdiff_t columns, const float *down, Offset *found,
                     float weights[VOTES][NODES]) {
    int count = 0;
    for (int row = 0; row < NODES; row++) {
        for (int column = 0; column < NODES; column++) {
            const Offset one = first[row * columns + column];
            int i = 0;
            while (i < count && (found[i].x != one.x || found[i].y != one.y)) i++;
            if (i == count) {
                found[count++] = one;
                for (int k = 0; k < NODES; k++) weights[i][k] = 0.0f;
            }
            weights[i][column] += down[row];
        }
    }
    return count;
}

/* Add a band's contribution to a row of texels. */
INLINE void vote(const Band *b, int32_t y, int32_t left,
                                                       int32_t count, const Offset *own,
                                                       int32_t half, Texel *total) {
    const Offset *nodes = b->offsets + (ptrdiff_t)b->first_row[y] * b->node_columns;
    const float *down = b->row_weights + (ptrdiff_t)y * NODES;
    Offset votes[VOTES];
    float downs[VOTES][NODES];
    int kinds = 0;
    for (int32_t c = 0; c < count; c++) {
        const int32_t x = left + c;
        if (!c || b->first_column[x] != b->first_column[x - 1])
            kinds = differing(nodes + b->first_column[x], b->node_columns, down, votes, downs);
        if (kinds == 1 && votes[0].x == own[c].x && votes[0].y == own[c].y) continue;
        Texel mine, other, sum;
        float gain = 1.0f;
        read_band(b, x + own[c].x, y + own[c].y, half, &mine);
        if (kinds == 1) {
            read_band(b, x + votes[0].x, y + votes[0].y, half, &sum);
        } else {
            const float *across = b->column_weights + (ptrdiff_t)x * NODES;
            float squares = 0.0f;
            LOOP
            for (int d = 0; d < CHANNELS; d++) sum.of[d] = 0.0f;
            for (int i = 0; i < kinds; i++) {
                const int same = votes[i].x == own[c].x && votes[i].y == own[c].y;
                if (!same) read_band(b, x + votes[i].x, y + votes[i].y, half, &other);
                const float *one = same ? mine.of : other.of;
                const float weight =
                    downs[i][0] * across[0] + downs[i][1] * across[1] + downs[i][2] * across[2];
                squares += weight * weight;
                LOOP
                for (int d = 0; d < CHANNELS; d++) sum.of[d] += weight * one[d];
            }
            gain = 1.0f / sqrtf(b->correlation + (1.0f - b->correlation) * squares);
        }
        LOOP
        for (int d = 0; d < CHANNELS; d++)
            total[c].of[d] +=
                b->scale[d] * ((1.0f + (gain - 1.0f) * b->kept[d]) * sum.of[d] - mine.of[d]);
    }
}

/* 2^x with a relative error of 2e-7, for |x| <= 30. */
INLINE float power(float x) {
    x = x < -30.0f ? -30.0f : x > 30.0f ? 30.0f : x;
    const int32_t whole = (int32_t)(x + 64.5f) - 64;
    const float f = (x - (float)whole) * 0.69314718f;
    const float found =
        1.0f +
        f * (1.0f + f * (1.0f / 2.0f +
                         f * (1.0f / 6.0f +
                              f * (1.0f / 24.0f + f * (1.0f / 120.0f + f * (1.0f / 720.0f))))));
    const uint32_t bits = (uint32_t)(whole + 127) << 23;
    float factor;
    memcpy(&factor, &bits, sizeof factor);
    return found * factor;
}

INLINE void blend(const Exemplar *e, const Band *bands,
                                                        int32_t count, int32_t columns,
                                                        int32_t rows, float *found) {
    const int32_t mask = (1 << e->bits) - 1, last = e->channels - 1;
    for (int32_t y = 0; y < rows; y++) {
        const Place *places =
            e->places + (ptrdiff_t)((e->top + y) >> e->bits) * e->place_columns;
        for (int32_t left = 0; left < columns; left += STRIP) {
            const int32_t some = columns - left < STRIP ? columns - left : STRIP;
            Offset own[STRIP];
            Texel total[STRIP];
            memset(total, 0, (size_t)some * sizeof *total);
            for (int32_t c = 0; c < some; c++) {
                const int32_t at = e->left + left + c;
                const Place p = places[at >> e->bits];
                own[c].x = (p.x << e->bits) + (at & mask) - (left + c);
                own[c].y = (p.y << e->bits) + ((e->top + y) & mask) - y;
            }
            for (int32_t k = 0; k < count; k++)
                vote(bands + k, y, left, some, own, mask, total);
            /* Within a patch the factor is 1 and the sum 0: the exemplar's bits are kept. */
            for (int32_t d = 0; d <= last; d++) {
                const float *plane = e->planes[d];
                float *to = found + ((ptrdiff_t)d * rows + y) * columns + left;
                float change[STRIP];
                for (int32_t c = 0; c < some; c++) change[c] = total[c].of[d];
                if (d < last - 1)
                    for (int32_t c = 0; c < some; c++) change[c] = power(change[c]);
                for (int32_t c = 0; c < some; c++)
                    to[c] = plane[(ptrdiff_t)(own[c].y + y) * e->columns + own[c].x + left + c];
                if (d < last - 1)
                    for (int32_t c = 0; c < some; c++) to[c] = to[c] * change[c];
                else
                    for (int32_t c = 0; c < some; c++) to[c] = to[c] + change[c];
                if (d < last)
                    for (int32_t c = 0; c < some; c++)
                        to[c] = to[c] < 0.0f ? 0.0f : to[c] > 1.0f ? 1.0f : to[c];
            }
        }
    }
}

/* blend.blended: found is channels x rows x columns. */
WIDE void matcap_blend(const Exemplar *e, const Band *bands, int32_t count, int32_t columns,
                       int32_t rows, float *found) {
    blend(e, bands, count, columns, rows, found);
}

/* inpaint._discontinuity: of blocks of `planes` (texels of FEATURES), which begin at `corners`, the
   sums over features of mean squared differences, each at most `most`, to what is `shown` at some
   texels (numbered from the corner), and of their variances there. found is 2 x blocks. */
enum { FEATURES = 4 };

WIDE void matcap_discontinuity(const float *planes, const float *shown, const int64_t *texels,
                               const int64_t *corners, int32_t known, int32_t blocks, float most,
                               float *found) {
    for (int32_t i = 0; i < blocks; i++) {
        const int64_t next = corners[i + 1 < blocks ? i + 1 : i];
        float difference[FEATURES] = {0}, sum[FEATURES] = {0}, squares[FEATURES] = {0};
        for (int32_t k = 0; k < known; k++) {
            const float *here = planes + FEATURES * (corners[i] + texels[k]);
            PREFETCH(planes + FEATURES * (next + texels[k])); /* memory takes longer than the sums */
            LOOP
            for (int d = 0; d < FEATURES; d++) {
                const float value = here[d], off = value - shown[FEATURES * k + d];
                difference[d] += off * off < most ? off * off : most;
                sum[d] += value;
                squares[d] += value * value;
            }
        }
        found[i] = found[blocks + i] = 0.0f;
        for (int d = 0; d < FEATURES; d++) {
            const float mean = sum[d] / (float)known;
            found[i] += difference[d] / (float)known;
            found[blocks + i] += squares[d] / (float)known - mean * mean;
        }
    }
}

/* inpaint._solved: image = diagonal * values - sum of values at the four neighbours, in their order,
   of texels x channels; a neighbour of number `texels` has the value 0. */
enum { SIDES = 4 };

WIDE void matcap_laplacian(const float *values, const int64_t *neighbours, const float *diagonal,
                           int32_t texels, int32_t channels, float *image) {
    for (ptrdiff_t i = 0; i < texels; i++) {
        float *own = image + i * channels;
        for (int32_t c = 0; c < channels; c++)
            own[c] = values[i * channels + c] * diagonal[i];
        for (int side = 0; side < SIDES; side++) {
            const int64_t other = neighbours[SIDES * i + side];
            if (other < texels)
                for (int32_t c = 0; c < channels; c++)
                    own[c] -= values[other * channels + c];
        }
    }
}
