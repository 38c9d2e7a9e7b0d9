/* Correction of the field by example: plain.py, compiled. Integers only, the same bits. */

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#if defined(__x86_64__) && defined(__GNUC__)
#define MATCAP_AVX2 /* asked for at run time */
#include <immintrin.h>
#elif defined(__SSE2__)
#include <emmintrin.h>
#endif

enum {
    /* As in appearance.py, grids.py and plain.py. */
    DIMENSIONS = 8,
    PLANES = 8,
    SIDE = 5,
    LARGEST = 700,
    DIAGONALS = 4,
    AROUND = 9,
    REACH = 2,
    PHASE_SHIFT = 2,
    PRICE_BITS = 2,
    STRIP = 512, /* places of a row that are looked at together */
};

typedef struct {
    int16_t x, y;
} Place;

/* Raised with every change of results or arguments, here and in compiled.py: a library that was
   built from another file is not used. */
enum { FORM = 2 };

int32_t matcap_form(void) { return FORM; }

typedef struct {
    uint16_t one, two;
} Phase;

typedef struct {
    const int16_t *appearance; /* rows x columns x DIMENSIONS */
    const int32_t *price;      /* of squares of 2^PRICE_BITS texels */
    const Place *similar;      /* similar_rows x similar_columns */
    const Phase *phases;       /* rows x columns, or NULL */
    int32_t columns, similar_columns, price_columns;
    int32_t bits, similar_bits;
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

/* The sum of (3 found - wanted)^2. */
static int32_t apart(const int16_t *found, const int16_t *wanted) {
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

/* At least most as soon as it is certain to be. */
static int32_t cost_of(const Level *l, int32_t x, int32_t y, const int16_t *wanted,
                       const Phase *ordered, int similar, int32_t most) {
    int32_t cost = 0;
    for (int k = 0; k < DIAGONALS; k++) {
        const int16_t *found =
            appearance_at(l, x + DIAGONAL[k][1] * l->spacing, y + DIAGONAL[k][0] * l->spacing);
        cost += apart(found, wanted + k * DIMENSIONS) << similar;
        if (cost >= most) return cost;
    }
    if (l->phases) {
        const ptrdiff_t place = (ptrdiff_t)(y >> l->bits) * l->columns + (x >> l->bits);
        const int32_t one = (int16_t)(l->phases[place].one - ordered->one) >> PHASE_SHIFT;
        const int32_t two = (int16_t)(l->phases[place].two - ordered->two) >> PHASE_SHIFT;
        cost += one * one + two * two;
    }
    return cost + l->price[(ptrdiff_t)(y >> PRICE_BITS) * l->price_columns + (x >> PRICE_BITS)];
}

/* Fetch what the cost of a place will read, which lies anywhere in megabytes. */
static void expect(const Level *l, Place p) {
#if defined(__GNUC__)
    for (int y = -1; y <= 1; y += 2)
        __builtin_prefetch(appearance_at(l, p.x - l->spacing, p.y + y * l->spacing));
#else
    (void)l, (void)p;
#endif
}

/* Adds a place to those to be tried, unless it is among them. */
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
        const int32_t cost =
            cost_of(l, tried[k].x, tried[k].y, wanted, ordered, k >= continued, best_cost);
        if (cost < best_cost) {
            best_cost = cost;
            best = tried[k];
        }
    }
    return best;
}

/* Whether places beyond a row's x-th are not all continued by their neighbours: not 0. Places are
   never negative, so that both coordinates are compared as one number. */
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

/* places and scratch: rows x columns. The outermost 8 * passes rows and columns end undefined. */
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

/* Sums of products of PLANES features with PLANES weights for each dimension, one tap after the
   other; exact, in whatever order they are added. */
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
/* The same of two places beside each other: (2, DIMENSIONS) sums. */
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
