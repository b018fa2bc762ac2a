/* Answers of wlr_render.h for test_c_model.py; the exit status is that of wlr_open.
 *
 *     c_answers MODEL                               opens it
 *     c_answers MODEL rays X Y Z < pixels           u v per line
 *     c_answers MODEL pixels X Y Z < points         x y z per line
 *     c_answers MODEL mesh X Y Z DEPTH COLUMNS ROWS
 *     c_answers MODEL time X Y Z                    microseconds of 81 rays, the least of 2000 means of 10
 */
#include "wlr_render.h"

#include <time.h>

#define MOST 4096

static wlr_ray rays[MOST];
static wlr_vertex vertices[MOST];
static uint32_t triangles[6 * MOST];
static double numbers[3 * MOST];

static size_t read_numbers(void) {
    size_t count = 0;
    while (count < 3 * MOST && scanf("%lf", numbers + count) == 1) ++count;
    return count;
}

int main(int argc, char **argv) {
    wlr_model model;
    double viewpoint[3] = {0.0, 0.0, 0.0};
    const int opened = argc > 1 ? wlr_open(argv[1], &model) : 99;
    if (opened != WLR_OPENED) return opened;
    for (int i = 0; i < 3 && argc > 5; ++i) viewpoint[i] = strtod(argv[3 + i], NULL);
    if (argc < 6) {
        wlr_close(&model);
        return WLR_OPENED;
    }
    if (strcmp(argv[2], "rays") == 0) {
        const size_t count = read_numbers() / 2;
        wlr_rays(&model, viewpoint, numbers, count, rays);
        for (size_t i = 0; i < count; ++i) {
            for (int k = 0; k < 3; ++k) printf("%.17g %.17g ", rays[i].origin[k], rays[i].direction[k]);
            printf("%.17g %d\n", rays[i].error_arcmin, rays[i].status);
        }
    } else if (strcmp(argv[2], "pixels") == 0) {
        const size_t count = read_numbers() / 3;
        for (size_t i = 0; i < count; ++i) {
            const wlr_pixel shown = wlr_pixel_of_point(&model, viewpoint, numbers + 3 * i);
            printf("%.17g %.17g %.17g %d\n", shown.pixel[0], shown.pixel[1], shown.error_arcmin, shown.status);
        }
    } else if (strcmp(argv[2], "mesh") == 0 && argc == 9) {
        const uint32_t columns = (uint32_t)atoi(argv[7]), rows = (uint32_t)atoi(argv[8]);
        const size_t count = wlr_mesh(&model, viewpoint, NULL, strtod(argv[6], NULL), columns, rows, vertices, triangles);
        for (size_t i = 0; i < (size_t)(columns + 1u) * (rows + 1u); ++i) {
            printf("%.17g %.17g %.17g %.17g ", vertices[i].position[0], vertices[i].position[1], vertices[i].texture[0],
                   vertices[i].texture[1]);
            printf("%.17g %d\n", vertices[i].error_arcmin, vertices[i].status);
        }
        for (size_t i = 0; i < count; ++i) printf("%u ", triangles[i]);
    } else if (strcmp(argv[2], "time") == 0) {
        double best = 1e9;
        for (int i = 0; i < 81; ++i) {
            numbers[2 * i] = model.panel_px[0] * (0.5 + i % 9) / 9;
            numbers[2 * i + 1] = model.panel_px[1] * (0.5 + i / 9) / 9;
        }
        for (int turn = 0; turn < 2000; ++turn) {
            const clock_t start = clock();
            for (int k = 0; k < 10; ++k) wlr_rays(&model, viewpoint, numbers, 81, rays);
            const double took = (double)(clock() - start) / CLOCKS_PER_SEC / 10;
            best = took < best ? took : best;
        }
        printf("81 nodes: %.1f us\n", 1e6 * best);
    }
    wlr_close(&model);
    wlr_close(&model);
    return WLR_OPENED;
}
