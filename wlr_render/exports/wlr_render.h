/* Rays, distortion meshes and panel pixels of a fitted AR headset, from the NAME.wlr beside this file. C99 or C++11,
 * the C library and libm; MIT licence. `wlr_open` allocates, no other function does. No function changes an open
 * model: threads may share it. Compile without -ffast-math, which removes the checks for NaN.
 * Lengths are metres in the device frame: x right, y up, looking along -z. A viewpoint is the centre of the entrance
 * pupil. Pixels are (u, v): (0, 0) is the outer corner of the top left pixel of the panel, v runs down. */
#ifndef WLR_RENDER_H
#define WLR_RENDER_H
#include <float.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define WLR_ORDER 31     /* highest order of a Chebyshev polynomial */
#define WLR_PRODUCTS 160 /* most products of two Chebyshev polynomials on each side of a polynomial */
#define WLR_WIDTH (4 * WLR_PRODUCTS) /* most coefficients of four outputs */
#define WLR_LONGEST 4194304       /* bytes of a file */
#define WLR_LIMIT 1.002           /* largest scaled input inside the fit; polynomials are linear beyond */
#define WLR_EYE_BOX_MARGIN 0.5e-3 /* distance outside the eye box that counts as inside */

enum { WLR_OPENED, WLR_CANNOT_READ, WLR_NOT_A_MODEL, WLR_OTHER_VERSION, WLR_DAMAGED, WLR_NO_MEMORY };
/* Status of an answer, as in Python; the numbers of answers above WLR_OUTSIDE_FIT are NaN. */
enum { WLR_OK, WLR_OUTSIDE_FIT, WLR_NOT_CONVERGED, WLR_MISS };

/* Sum over heads h and tails k of c[h][k][output] f_h(x0, x1) g_k(x2, x3), where f and g are products of two Chebyshev
 * polynomials of the inputs scaled to -1..1. */
typedef struct {
    double low[4], high[4], *c;
    int outputs, count[2], highest; /* products on each side, highest order of a factor */
    int used[WLR_PRODUCTS];         /* tails of each head up to the last coefficient other than zero */
    unsigned char order[2][WLR_PRODUCTS][2];
} wlr_polynomial;

typedef struct {
    uint32_t is_right_eye, panel_px[2];
    double eye_box_centre[3], eye_box_size[3];
    double plane[2][3];           /* base plane of display and see-through: z, slope of x and of y */
    double device_from_camera[9]; /* axes of the source camera of `wlr_mesh`, row by row */
    double borders[4];            /* its tangents left, right, bottom, top */
    wlr_polynomial display;       /* (u, v, x, y) -> view tangents (tx, ty) of the ray through (x, y) of the plane */
    wlr_polynomial see_through;   /* (x, y, tx, ty) -> change of tangents (Ax, Ay), offset in metres (Bx, By) */
    uint32_t error_cells[2];      /* rows and columns over the panel; 0 if no error is known */
    double *square_error;         /* rows, columns, then 3 pupils along z, y, x: square arcminutes */
} wlr_model;

typedef struct {
    double origin[3], direction[3]; /* the world's ray that the pixel must show; the direction is a unit vector */
    double error_arcmin;            /* predicted rms registration error for points at infinity; NaN if unknown */
    int status;
} wlr_ray;
typedef struct {
    double position[2]; /* clip coordinates of the panel, -1 to 1, y up */
    double texture[2];  /* place in the source picture, (0, 0) its top left corner, (1, 1) its bottom right one */
    double error_arcmin;
    int status;
} wlr_vertex;
typedef struct { double pixel[2], error_arcmin; int status; } wlr_pixel;

static inline int wlr_is_finite(double x) { return fabs(x) <= DBL_MAX; }

typedef struct {
    double value[WLR_PRODUCTS], slope[2][WLR_PRODUCTS], excess[WLR_PRODUCTS];
    int is_inside;
} wlr_products;

/* A polynomial whose first two inputs are given: coefficients of its tails. */
typedef struct {
    const wlr_polynomial *p;
    int is_inside;
    const double *here; /* `border` inside the fit, else `outside` */
    double border[WLR_WIDTH], outside[WLR_WIDTH], by[2][WLR_WIDTH];
} wlr_head;

/* Products of one side (0 heads, 1 tails) at two inputs. Outside the fit they are those of its border; value + excess
 * continues them to first order. */
static inline void wlr_products_at(const wlr_polynomial *p, int side, const double *input, int with_slope,
                                   wlr_products *out) {
    double t[2][WLR_ORDER + 1], d[2][WLR_ORDER + 1], per_unit[2], beyond[2];
    for (int i = 0; i < 2; ++i) {
        const double low = p->low[2 * side + i], high = p->high[2 * side + i];
        const double x = (2.0 * input[i] - low - high) / (high - low);
        const double s = x > WLR_LIMIT ? WLR_LIMIT : x < -WLR_LIMIT ? -WLR_LIMIT : x;
        beyond[i] = x - s, per_unit[i] = 2.0 / (high - low);
        out->is_inside = (i == 0 || out->is_inside) && fabs(x) <= WLR_LIMIT;
        t[i][0] = 1.0, t[i][1] = s, d[i][0] = 0.0, d[i][1] = 1.0; /* Chebyshev polynomials and their derivatives */
        for (int k = 2; k <= p->highest; ++k) {
            t[i][k] = 2.0 * s * t[i][k - 1] - t[i][k - 2];
            d[i][k] = 2.0 * t[i][k - 1] + 2.0 * s * d[i][k - 1] - d[i][k - 2];
        }
    }
    for (int k = 0; k < p->count[side]; ++k) {
        const int i = p->order[side][k][0], j = p->order[side][k][1];
        out->value[k] = t[0][i] * t[1][j];
        if (out->is_inside && !with_slope) continue;
        const double by_x = d[0][i] * t[1][j], by_y = t[0][i] * d[1][j];
        out->slope[0][k] = by_x * per_unit[0], out->slope[1][k] = by_y * per_unit[1];
        out->excess[k] = by_x * beyond[0] + by_y * beyond[1];
    }
}

/* Coefficients of the tails for weights of the heads, added to those in `more` unless it is NULL. */
static inline void wlr_heads(const wlr_polynomial *p, const double *weight, const double *more, double *out) {
    const int width = p->count[1] * p->outputs;
    for (int i = 0; i < width; ++i) out[i] = more ? more[i] : 0.0;
    for (int h = 0; h < p->count[0]; ++h)
        for (int i = 0; i < p->used[h] * p->outputs; ++i) out[i] += weight[h] * p->c[h * width + i];
}

static inline void wlr_hold(const wlr_polynomial *p, const double *input, int with_slope, wlr_head *head) {
    wlr_products at;
    wlr_products_at(p, 0, input, with_slope, &at);
    head->p = p, head->is_inside = at.is_inside, head->here = at.is_inside ? head->border : head->outside;
    wlr_heads(p, at.value, NULL, head->border);
    if (!at.is_inside) wlr_heads(p, at.excess, head->border, head->outside);
    for (int i = 0; i < 2 && with_slope; ++i) wlr_heads(p, at.slope[i], NULL, head->by[i]);
}

static inline void wlr_tails(const wlr_polynomial *p, const double *held, const double *tail, double *out, int adds) {
    for (int o = 0; o < p->outputs; o += 2) { /* outputs are pairs of x and y */
        double x = adds ? out[o] : 0.0, y = adds ? out[o + 1] : 0.0;
        const double *c = held + o;
        for (int k = 0; k < p->count[1]; ++k, c += p->outputs) x += c[0] * tail[k], y += c[1] * tail[k];
        out[o] = x, out[o + 1] = y;
    }
}

/* Value, and derivative by input `first` and later ones, slope[input][output]; returns whether all are inside. */
static inline int wlr_value(const wlr_head *head, const double *input, int first, double *value, double (*slope)[4]) {
    wlr_products at;
    wlr_products_at(head->p, 1, input, first < 4, &at);
    wlr_tails(head->p, head->here, at.value, value, 0);
    if (!at.is_inside) wlr_tails(head->p, head->border, at.excess, value, 1);
    for (int i = first; i < 4; ++i) {
        const double *held = i < 2 ? head->by[i] : at.is_inside ? head->here : head->border;
        wlr_tails(head->p, held, i < 2 ? at.value : at.slope[i - 2], slope[i], 0);
    }
    return head->is_inside && at.is_inside;
}

typedef struct {
    const wlr_model *model;
    const double *viewpoint, *target; /* target: what the residual compares with */
    wlr_head *head;
    double inverse_depth, value[4];
    int is_inside;
} wlr_problem;

/* Residual of an equation at x, and its derivative row by row. */
typedef void (*wlr_residual)(wlr_problem *, const double *x, double *r, double *by);

/* Newton's method from x; a step that does not shrink the residual is halved. Returns whether it converged. */
static inline int wlr_newton(wlr_residual residual, wlr_problem *problem, double *x) {
    double base[2] = {x[0], x[1]}, step[2] = {0.0, 0.0}, size_at_base = HUGE_VAL, r[2], by[4];
    for (int k = 0; k < 60; ++k) {
        x[0] = base[0] - step[0], x[1] = base[1] - step[1];
        residual(problem, x, r, by);
        const double size = sqrt(r[0] * r[0] + r[1] * r[1]), determinant = by[0] * by[3] - by[1] * by[2];
        if (size <= 1e-12) return 1;
        if (size < size_at_base) {
            base[0] = x[0], base[1] = x[1], size_at_base = size;
            step[0] = (by[3] * r[0] - by[1] * r[1]) / determinant;
            step[1] = (by[0] * r[1] - by[2] * r[0]) / determinant;
        } else step[0] *= 0.5, step[1] *= 0.5;
    }
    return 0;
}

/* Where the ray of view tangents t crosses a base plane: (x, y), its depth and the depth's derivative by t. */
static inline double wlr_cross(const double *plane, const double *v, const double *t, double *at, double *by_t) {
    const double per_height = 1.0 / (1.0 + plane[1] * t[0] + plane[2] * t[1]);
    const double depth = (v[2] - plane[0] - plane[1] * v[0] - plane[2] * v[1]) * per_height;
    for (int i = 0; i < 2; ++i) at[i] = v[i] + depth * t[i], by_t[i] = -depth * per_height * plane[1 + i];
    return depth;
}

/* x is the place on the display's base plane; the pixel is in `head`. */
static inline void wlr_place_residual(wlr_problem *a, const double *x, double *r, double *by) {
    double s[4][4], at[2], depth_by[2];
    a->is_inside = wlr_value(a->head, x, 2, a->value, s);
    const double *t = a->value, depth = wlr_cross(a->model->plane[0], a->viewpoint, t, at, depth_by);
    for (int n = 0; n < 4; ++n) {
        const int i = n / 2, j = 2 + n % 2;
        r[i] = x[i] - at[i];
        by[n] = (n % 3 ? 0.0 : 1.0) - depth * s[j][i] - t[i] * (depth_by[0] * s[j][0] + depth_by[1] * s[j][1]);
    }
}

/* x are view tangents; the target is the straight line to a real point. */
static inline void wlr_view_residual(wlr_problem *a, const double *x, double *r, double *by) {
    double at[2], s[4][4], depth_by[2], d[2];
    const double depth = wlr_cross(a->model->plane[1], a->viewpoint, x, at, depth_by);
    const double near_ = a->inverse_depth, far_ = 1.0 - depth * near_;
    wlr_hold(&a->model->see_through, at, 1, a->head);
    a->is_inside = wlr_value(a->head, x, 0, a->value, s);
    for (int n = 0; n < 4; ++n) {
        const int i = n / 2, j = n % 2;
        for (int k = 0, o = i; k < 2; ++k, o += 2) /* derivative of A and B by x_j, along which the place moves, too */
            d[k] = s[2 + j][o] + depth * s[j][o] + (s[0][o] * x[0] + s[1][o] * x[1]) * depth_by[j];
        r[i] = x[i] - a->target[i] + far_ * a->value[i] + near_ * a->value[2 + i];
        by[n] = (i == j ? 1.0 : 0.0) + far_ * d[0] + near_ * (d[1] - depth_by[j] * a->value[i]);
    }
}

/* x is the pixel; the target are view tangents and the place on the display's base plane. */
static inline void wlr_pixel_residual(wlr_problem *a, const double *x, double *r, double *by) {
    double s[4][4];
    wlr_hold(&a->model->display, x, 1, a->head);
    a->is_inside = wlr_value(a->head, a->target + 2, 0, a->value, s);
    for (int n = 0; n < 4; ++n) r[n / 2] = a->value[n / 2] - a->target[n / 2], by[n] = s[n % 2][n / 2];
}

static inline int wlr_in_eye_box(const wlr_model *m, const double *v) {
    int n = 0; /* axes along which the viewpoint is inside */
    for (int i = 0; i < 3; ++i) n += fabs(v[i] - m->eye_box_centre[i]) <= 0.5 * m->eye_box_size[i] + WLR_EYE_BOX_MARGIN;
    return n == 3;
}

/* Predicted rms registration error of a pixel in arcminutes, from square errors: linear over the panel between the
 * centres of cells, quadratic over the eye box; NaN if unknown. */
static inline double wlr_error_at(const wlr_model *m, const double *viewpoint, const double *pixel) {
    size_t from[2];
    double share[2], w[3][3], sum = 0.0;
    for (int i = 0; i < 2; ++i) {
        const double last = m->error_cells[i] - 1.0, cell = pixel[1 - i] / m->panel_px[1 - i] * (last + 1.0) - 0.5;
        if (!m->square_error || !wlr_is_finite(cell)) return (double)NAN;
        const double x = fmin(fmax(cell, 0.0), last);
        from[i] = (size_t)fmin(floor(x), last - 1.0), share[i] = x - (double)from[i];
    }
    for (int i = 0; i < 3; ++i) {
        const double away = 2.0 * (viewpoint[2 - i] - m->eye_box_centre[2 - i]) / m->eye_box_size[2 - i];
        const double x = fmin(fmax(away, -1.0), 1.0);
        w[i][0] = 0.5 * x * (x - 1.0), w[i][1] = 1.0 - x * x, w[i][2] = 0.5 * x * (x + 1.0);
    }
    const double *square = m->square_error + 27 * (from[0] * m->error_cells[1] + from[1]);
    for (int k = 0; k < 27; ++k, ++square) {
        const double *a = square, *b = square + 27 * (size_t)m->error_cells[1];
        if (fmin(fmin(a[0], a[27]), fmin(b[0], b[27])) < 0.0) return (double)NAN;
        const double above = a[0] + share[1] * (a[27] - a[0]), below = b[0] + share[1] * (b[27] - b[0]);
        sum += w[0][k / 9] * w[1][k / 3 % 3] * w[2][k % 3] * (above + share[0] * (below - above));
    }
    return sqrt(fmax(sum, 0.0));
}

/* World rays of `count` nodes, pixels u, v one after the other, for a viewpoint (3). */
static inline void wlr_rays(const wlr_model *m, const double *viewpoint, const double *nodes, size_t count,
                            wlr_ray *out) {
    const int in_eye_box = wlr_in_eye_box(m, viewpoint);
    const double *plane = m->plane[1];
    for (; count > 0; --count, nodes += 2, ++out) {
        wlr_head head;
        wlr_problem problem = {m, viewpoint, NULL, &head, 0.0, {0.0, 0.0, 0.0, 0.0}, 0};
        double at[2] = {viewpoint[0], viewpoint[1]}, unused[2], bent[4];
        wlr_hold(&m->display, nodes, 0, &head);
        const int solved = wlr_newton(wlr_place_residual, &problem, at);
        wlr_cross(plane, viewpoint, problem.value, at, unused);
        wlr_hold(&m->see_through, at, 0, &head);
        const int inside = wlr_value(&head, problem.value, 4, bent, NULL) && problem.is_inside && in_eye_box;
        const double x = problem.value[0] + bent[0], y = problem.value[1] + bent[1], length = sqrt(x * x + y * y + 1.0);
        const double ray[6] = {at[0] + bent[2], at[1] + bent[3], plane[0] + plane[1] * at[0] + plane[2] * at[1],
                               x / length, y / length, -1.0 / length};
        const int given = wlr_is_finite(nodes[0] + nodes[1] + viewpoint[0] + viewpoint[1] + viewpoint[2]);
        const int found = given && solved && wlr_is_finite(length + ray[0] + ray[1]);
        out->status = !given ? WLR_MISS : !found ? WLR_NOT_CONVERGED : inside ? WLR_OK : WLR_OUTSIDE_FIT;
        out->error_arcmin = found ? wlr_error_at(m, viewpoint, nodes) : (double)NAN;
        for (int i = 0; i < 3; ++i) {
            out->origin[i] = found ? ray[i] : (double)NAN;
            out->direction[i] = found ? ray[3 + i] : (double)NAN;
        }
    }
}

/* The pixel that shows a real point (3) to a viewpoint (3). It may lie outside the panel. */
static inline wlr_pixel wlr_pixel_of_point(const wlr_model *m, const double *viewpoint, const double *point) {
    const double depth = viewpoint[2] - point[2], *low = m->display.low, *high = m->display.high;
    const double straight[2] = {(point[0] - viewpoint[0]) / depth, (point[1] - viewpoint[1]) / depth};
    double target[4] = {straight[0], straight[1], 0.0, 0.0}, unused[2];
    wlr_head head;
    wlr_problem problem = {m, viewpoint, straight, &head, 1.0 / depth, {0.0, 0.0, 0.0, 0.0}, 0};
    wlr_pixel out = {{(double)NAN, (double)NAN}, (double)NAN, WLR_MISS};
    if (!(depth > 0.0) || !wlr_is_finite(straight[0] + straight[1] + depth)) return out;
    out.status = WLR_NOT_CONVERGED;
    if (!wlr_newton(wlr_view_residual, &problem, target)) return out;
    const int inside = problem.is_inside && wlr_in_eye_box(m, viewpoint);
    wlr_cross(m->plane[0], viewpoint, target, target + 2, unused);
    problem.target = target;
    for (int n = 0; n < 9 && out.status == WLR_NOT_CONVERGED; ++n) { /* from the middle of the panel, then around it */
        const double across = ((n + 1) % 3 + 0.5) / 3, down = ((n / 3 + 1) % 3 + 0.5) / 3;
        double x[2] = {low[0] + (high[0] - low[0]) * across, low[1] + (high[1] - low[1]) * down};
        if (!wlr_newton(wlr_pixel_residual, &problem, x)) continue;
        out.pixel[0] = x[0], out.pixel[1] = x[1];
        out.status = inside && problem.is_inside ? WLR_OK : WLR_OUTSIDE_FIT;
        out.error_arcmin = wlr_error_at(m, viewpoint, x);
    }
    return out;
}

/* A mesh of columns x rows cells over the panel, for points `depth_m` in front of the source camera along its axis
 * (INFINITY is allowed). The camera has the model's axes and borders; NULL puts it at the viewpoint.
 * vertices: (columns + 1) (rows + 1), row by row from the top left corner. triangles: room for 6 columns rows indices,
 * counter-clockwise; cells with a corner without a ray have none. Returns the number of indices. */
static inline size_t wlr_mesh(const wlr_model *m, const double *viewpoint, const double *camera, double depth_m,
                              uint32_t columns, uint32_t rows, wlr_vertex *vertices, uint32_t *triangles) {
    const double *edge = m->borders, *place = camera ? camera : viewpoint;
    size_t count = 0;
    for (size_t n = 0; n < (size_t)(columns + 1u) * (rows + 1u); ++n) {
        const double x = (double)(n % (columns + 1u)) / columns, y = (double)(n / (columns + 1u)) / rows;
        const double pixel[2] = {x * m->panel_px[0], y * m->panel_px[1]};
        double d[3] = {0.0, 0.0, 0.0}, o[3] = {0.0, 0.0, 0.0};
        wlr_ray ray;
        wlr_rays(m, viewpoint, pixel, 1, &ray);
        for (int i = 0; i < 9; ++i) {
            d[i % 3] += m->device_from_camera[i] * ray.direction[i / 3];
            o[i % 3] += m->device_from_camera[i] * (ray.origin[i / 3] - place[i / 3]);
        }
        const double a = d[0] / -d[2], b = d[1] / -d[2]; /* at depth Z the ray is at a Z + o_x + o_z a, likewise in y */
        const double tx = a + (o[0] + o[2] * a) / depth_m, ty = b + (o[1] + o[2] * b) / depth_m;
        const int is_seen = d[2] < 0.0 && wlr_is_finite(tx + ty);
        wlr_vertex *vertex = vertices + n;
        vertex->position[0] = 2.0 * x - 1.0, vertex->position[1] = 1.0 - 2.0 * y;
        vertex->texture[0] = is_seen ? (tx - edge[0]) / (edge[1] - edge[0]) : (double)NAN;
        vertex->texture[1] = is_seen ? (edge[3] - ty) / (edge[3] - edge[2]) : (double)NAN;
        vertex->error_arcmin = is_seen ? ray.error_arcmin : (double)NAN;
        vertex->status = is_seen || ray.status > WLR_OUTSIDE_FIT ? ray.status : WLR_MISS;
    }
    for (uint32_t n = 0; n < columns * rows; ++n) {
        const uint32_t a = n + n / columns, b = a + 1u, c = a + columns + 1u, corners[6] = {a, c, b, b, c, c + 1u};
        int is_seen = 1;
        for (int i = 0; i < 6; ++i) is_seen &= vertices[corners[i]].status <= WLR_OUTSIDE_FIT;
        for (int i = 0; i < 6 && is_seen; ++i) triangles[count++] = corners[i];
    }
    return count;
}

/* ---- Files; docs/exports.md of wlr_render lists the bytes ---- */

typedef struct {
    const unsigned char *at;
    size_t left;
    int error; /* of `wlr_open`: the bytes are too few, or a number is not allowed */
} wlr_reader;

static inline uint32_t wlr_u32(wlr_reader *r, uint32_t least, uint32_t most) {
    uint32_t value = 0;
    for (unsigned i = 0; i < 4 && r->left >= 4; ++i) value |= (uint32_t)r->at[i] << 8u * i;
    if (r->left < 4 || value < least || value > most) r->error = r->error ? r->error : WLR_DAMAGED;
    else r->at += 4, r->left -= 4;
    return value;
}

static inline void wlr_f64(wlr_reader *r, double *out, size_t count) {
    for (; count > 0 && !r->error; --count, ++out) {
        const uint64_t low = wlr_u32(r, 0, UINT32_MAX), bits = low | (uint64_t)wlr_u32(r, 0, UINT32_MAX) << 32u;
        memcpy(out, &bits, sizeof bits);
        if (!(fabs(*out) <= 1e9)) r->error = WLR_DAMAGED; /* NaN, too */
    }
}

/* Allocates and reads an array whose length must fit into the rest of the file. */
static inline double *wlr_array(wlr_reader *r, size_t count) {
    if (!r->error && count > r->left / 8) r->error = WLR_DAMAGED;
    double *out = r->error ? NULL : (double *)malloc(count * sizeof(double));
    if (!r->error && !out) r->error = WLR_NO_MEMORY;
    wlr_f64(r, out, count);
    return out;
}

static inline void wlr_read_polynomial(wlr_reader *r, wlr_polynomial *p, int outputs) {
    if (r->error) return;
    const uint32_t heads = wlr_u32(r, 1, WLR_PRODUCTS), tails = wlr_u32(r, 1, WLR_PRODUCTS);
    wlr_f64(r, p->low, 4), wlr_f64(r, p->high, 4);
    for (int i = 0; i < 4; ++i) if (!(p->high[i] - p->low[i] > 1e-9)) r->error = WLR_DAMAGED;
    for (uint32_t i = 0; !r->error && i < 2 * (heads + tails); ++i) {
        const uint32_t k = i / 2, order = wlr_u32(r, 0, WLR_ORDER);
        p->order[k >= heads][k < heads ? k : k - heads][i % 2] = (unsigned char)(order & 255u);
        p->highest = (int)order > p->highest ? (int)order : p->highest;
    }
    if (r->error) return;
    p->outputs = outputs, p->count[0] = (int)heads, p->count[1] = (int)tails;
    p->c = wlr_array(r, (size_t)heads * tails * (size_t)outputs);
    const int width = (int)tails * outputs;
    for (int i = 0; !r->error && i < (int)heads * width; ++i)
        if (fabs(p->c[i]) > 0.0) p->used[i / width] = i % width / outputs + 1;
}

static inline uint32_t wlr_crc32(const unsigned char *bytes, size_t count) {
    uint32_t crc = UINT32_MAX;
    for (size_t i = 0; i < 8 * count; ++i) {
        if (i % 8 == 0) crc ^= bytes[i / 8];
        crc = crc >> 1u ^ (crc & 1u ? 0xedb88320u : 0u);
    }
    return ~crc;
}

/* Frees an open model; a second call does nothing. */
static inline void wlr_close(wlr_model *m) {
    free(m->display.c), free(m->see_through.c), free(m->square_error);
    memset(m, 0, sizeof *m);
}

/* Opens a model from the bytes of its file, of which it copies what it needs. */
static inline int wlr_open_bytes(const void *bytes, size_t count, wlr_model *m) {
    wlr_reader r = {(const unsigned char *)bytes, count, WLR_OPENED};
    memset(m, 0, sizeof *m);
    if (count < 16 || memcmp(bytes, "wlrmodel", 8) != 0) return WLR_NOT_A_MODEL;
    r.at += 8, r.left -= 8;
    if (wlr_u32(&r, 0, UINT32_MAX) != 1u) return WLR_OTHER_VERSION;
    if (wlr_u32(&r, 0, UINT32_MAX) != wlr_crc32(r.at, r.left)) return WLR_DAMAGED;
    m->is_right_eye = wlr_u32(&r, 0, 1);
    for (int i = 0; i < 2; ++i) m->panel_px[i] = wlr_u32(&r, 1, 1000000);
    wlr_f64(&r, m->eye_box_centre, 3), wlr_f64(&r, m->eye_box_size, 3);
    wlr_f64(&r, m->plane[0], 3), wlr_f64(&r, m->plane[1], 3);
    wlr_f64(&r, m->device_from_camera, 9), wlr_f64(&r, m->borders, 4);
    for (int i = 0; i < 3; ++i) if (!(m->eye_box_size[i] > 0.0)) r.error = WLR_DAMAGED;
    if (!(m->borders[0] < m->borders[1] && m->borders[2] < m->borders[3])) r.error = WLR_DAMAGED;
    wlr_read_polynomial(&r, &m->display, 2), wlr_read_polynomial(&r, &m->see_through, 4);
    for (int i = 0; i < 2; ++i) m->error_cells[i] = wlr_u32(&r, 0, 100);
    const size_t rows = m->error_cells[0], columns = m->error_cells[1];
    if (rows == 1 || columns == 1 || !rows != !columns) r.error = WLR_DAMAGED;
    if (rows && !r.error) m->square_error = wlr_array(&r, 27 * rows * columns);
    if (r.left && !r.error) r.error = WLR_DAMAGED;
    if (r.error) wlr_close(m);
    return r.error;
}

/* Opens a model file; after another result than WLR_OPENED the model needs no `wlr_close`. */
static inline int wlr_open(const char *path, wlr_model *m) {
    FILE *file = fopen(path, "rb");
    void *bytes = malloc(WLR_LONGEST);
    memset(m, 0, sizeof *m);
    const size_t count = file && bytes ? fread(bytes, 1, WLR_LONGEST, file) : 0;
    int result = !bytes ? WLR_NO_MEMORY : !file || ferror(file) ? WLR_CANNOT_READ : WLR_OPENED;
    if (result == WLR_OPENED) result = wlr_open_bytes(bytes, count, m);
    if (file) fclose(file);
    free(bytes);
    return result;
}

#endif
