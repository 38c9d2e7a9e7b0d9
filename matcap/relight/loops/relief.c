/* The height field: heights, shadow rays, view rays. */

#include "loops.h"

void matcap_relight_heights(const Field *f, int64_t count, const double *column,
                            const double *row, float *found) {
    for (int64_t i = 0; i < count; i++) found[i] = surface(f, column[i], row[i]);
}

/* Whether light from directions (x, y, z), unit vectors, arrives at places on the surface. */
WIDE void matcap_relight_lit(const Field *f, int64_t count, const double *column,
                             const double *row, const float *height, const float *x,
                             const float *y, const float *z, const float *distance,
                             uint8_t *lit) {
    for (int64_t i = 0; i < count; i++)
        lit[i] = z[i] > 0.0f && arrives(f, column[i], row[i], height[i], x[i], y[i], z[i],
                                        distance ? distance[i] : HUGE_VAL);
}

typedef struct {
    const float *peaks; /* maximum of the heights within `around` texels of each */
    int32_t around;
    float steepest;             /* least z of a ray's unit vector */
    float most, least, density; /* number of steps: largest, least, for each texel of the path */
} Search;

/* Moves columns and rows from the undisplaced surface to the intersections of view rays with the
   displaced one; height: there. Linear search downwards, then one secant step [policarpo2005]. */
WIDE void matcap_relight_met(const Field *f, const Search *s, int64_t count, double *column,
                             double *row, const float *vx, const float *vy, const float *vz,
                             float *height) {
    double span = f->high - f->low;
    for (int64_t i = 0; i < count; i++) {
        float steep = 1.0f / larger(vz[i], s->steepest), du = vx[i] * steep, dv = vy[i] * steep;
        float pace = sqrtf(du * du + dv * dv) * (float)(span / f->texel);
        double steps = ceil(s->density * pace);
        steps = steps < s->least ? s->least : steps > s->most ? s->most : steps;
        /* Largest number of steps that stay within `around` texels. */
        double near = floor((s->around - 2) * steps / (pace > 1e-6f ? pace : 1e-6f));
        near = near > 1.0 ? near : 1.0;
        double across = du / f->texel, down = -dv / f->texel, step = span / steps, index = 0.0;
        double found = f->low;
        while (index <= steps) {
            double level = f->high - step * index;
            double x = column[i] + across * level, y = row[i] + down * level;
            double gap = level - surface(f, x, y);
            if (gap <= 0.0) {
                /* The crossing of two straight lines between the last two steps. */
                double before = index > 0.0 ? level + step : level;
                double over =
                    before - surface(f, column[i] + across * before, row[i] + down * before);
                double apart = over - gap > 1e-12 ? over - gap : 1e-12;
                found = (float)(before - (before - level) * (over / apart));
                break;
            }
            /* Skip the steps that are above the highest texel around. */
            double clear = level - s->peaks[nearest(f->columns, f->rows, x, y)];
            clear = floor(clear / (step > 1e-30 ? step : 1e-30)) - 1.0;
            clear = clear < near ? clear : near;
            index += clear > 1.0 ? clear : 1.0;
        }
        column[i] += across * found, row[i] += down * found;
        /* The secant ends near the surface; shadow rays must start on it. */
        height[i] = surface(f, column[i], row[i]);
    }
}
