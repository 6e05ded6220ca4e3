// SPDX-License-Identifier: MIT
// relight room compare: two revisions, or a decision's revision and the scene as it is now, in
// numbers (CIEDE2000) and as a picture.
#include "picture_compare.h"
#include "room.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct side {
    struct relight_room_view view;
    struct relight_image image; // RGB8
    char name[80];
};

static int bad_side(struct room_call *c, const char *word)
{
    return report_usage(c->options, "%s: expected a revision's number, or now", word);
}

// "now": the scene as it is.
static int read_side(struct room_call *c, const char *word, struct side *s)
{
    uint64_t number = 0;
    if (strcmp(word, "now") && (!whole_word(word, &number) || !number || number > UINT32_MAX))
        return bad_side(c, word);
    s->view.revision = (uint32_t)number;
    if (number) snprintf(s->name, sizeof s->name, "revision %u", s->view.revision);
    else snprintf(s->name, sizeof s->name, "now");
    return EXIT_DONE;
}

static const cJSON *last_decision(const cJSON *state)
{
    const cJSON *list = list_of(state, "decisions");
    int n = cJSON_GetArraySize(list);
    return n ? cJSON_GetArrayItem(list, n - 1) : NULL;
}

// The newest decision against the scene now.
static int decision_side(struct room_call *c, struct side *s, struct side *now)
{
    cJSON *state = room_state(c);
    if (!state) return EXIT_FAILED;
    const cJSON *d = last_decision(state);
    if (!d) {
        cJSON_Delete(state);
        return report_usage(
            c->options,
            "the room has no decision: relight room compare ROOM REVISION [REVISION]");
    }
    const cJSON *stamp = list_of(d, "stamp");
    s->view.decision = (uint64_t)number_of(stamp, "sequence");
    snprintf(s->name, sizeof s->name, "%s by %.30s at revision %.0f",
             cJSON_IsTrue(list_of(d, "approve")) ? "approved" : "rejected",
             escape(author_of(stamp)).text, number_of(list_of(d, "seen"), "revision"));
    struct room_now is;
    room_now(c, state, &is);
    const char *model = room_model_change(d, &is);
    int n = is.revision ? snprintf(now->name, sizeof now->name, "now at %u", is.revision)
                        : snprintf(now->name, sizeof now->name, "now");
    if (*model) snprintf(now->name + n, sizeof now->name - (size_t)n, "; %s", model);
    cJSON_Delete(state);
    return EXIT_DONE;
}

static int draw(struct room_call *c, struct side *s)
{
    s->view.format = RELIGHT_IMAGE_RGB8;
    if (relight_room_picture(c->client, c->room, &s->view, &s->image, &c->error))
        return ROOM_NOT_DRAWN;
    if (s->image.n_byte >= 3 * (uint64_t)s->image.width * s->image.height) return EXIT_DONE;
    return report_usage(c->options, "the daemon's picture is too short: update the client");
}

static void print_numbers(const struct room_call *c, const struct side side[2],
                          const struct picture_difference *d)
{
    if (!c->options->json) {
        printf("%s, %s: dE2000 mean %.3f, median %.3f, 95 %% %.3f, most %.3f\n", side[0].name,
               side[1].name, d->mean, d->median, d->p95, d->most);
        printf("%.2f %% of the pixels differ, by %.3f in the mean; %.2f %% by more than 1\n",
               100 * d->changed, d->changed_mean, 100 * d->noticeable);
        return;
    }
    cJSON *json = cJSON_CreateObject();
    cJSON_AddStringToObject(json, "a", side[0].name);
    cJSON_AddStringToObject(json, "b", side[1].name);
    cJSON_AddNumberToObject(json, "mean", d->mean);
    cJSON_AddNumberToObject(json, "median", d->median);
    cJSON_AddNumberToObject(json, "p95", d->p95);
    cJSON_AddNumberToObject(json, "max", d->most);
    cJSON_AddNumberToObject(json, "changed", d->changed);
    cJSON_AddNumberToObject(json, "changed_mean", d->changed_mean);
    cJSON_AddNumberToObject(json, "noticeable", d->noticeable);
    print_json(json);
}

static int no_memory(struct room_call *c)
{
    c->error = (struct relight_error){.code = RELIGHT_E_NO_MEMORY, .text = "not enough memory"};
    return room_failed(c);
}

static int write_sheet(struct room_call *c, const char *path, enum compare_layout layout,
                       const struct side side[2], const float *delta)
{
    uint32_t width = side[0].image.width, height = side[0].image.height;
    size_t n = 0;
    uint8_t *rgb = compare_draw(layout, side[0].image.data, side[1].image.data, delta, width,
                                height, &width, &height);
    void *png = rgb ? encode_png(rgb, width, height, &n) : NULL;
    int status = png ? write_file(c->options, path, png, n) : no_memory(c);
    free(png);
    free(rgb);
    return status;
}

static int compare(struct room_call *c, const char *path, enum compare_layout layout,
                   const struct side side[2])
{
    const struct relight_image *a = &side[0].image, *b = &side[1].image;
    struct picture_difference d;
    size_t n = (size_t)a->width * a->height;
    if (a->width != b->width || a->height != b->height)
        return report_usage(c->options, "the daemon drew %ux%u in place of %ux%u: update it",
                            b->width, b->height, a->width, a->height);
    float *delta = malloc((n + 1) * sizeof *delta);
    int status = EXIT_DONE;
    if (!delta || !picture_compare(a->data, b->data, n, delta, &d)) status = no_memory(c);
    else if (path) status = write_sheet(c, path, layout, side, delta);
    if (!status) print_numbers(c, side, &d);
    free(delta);
    return status;
}

static int read_layout(struct room_call *c, enum compare_layout *out)
{
    static const char *const words[] = {"sheet", "side", "wipe", "delta"};
    const char *text = c->options->layout;
    *out = COMPARE_SHEET;
    for (int i = 0; text && i < 4; i++)
        if (!strcmp(text, words[i])) {
            *out = (enum compare_layout)i;
            return EXIT_DONE;
        }
    return text ? report_usage(c->options, "--layout %s: expected sheet, side, wipe or delta",
                               text)
                : EXIT_DONE;
}

static int compare_sides(struct room_call *c, const char *path, enum compare_layout layout,
                         struct side side[2])
{
    side[0].view.width = c->options->picture.width;
    side[0].view.height = c->options->picture.height;
    int status = draw(c, &side[0]);
    // Both in the size of the first.
    side[1].view.width = side[0].image.width;
    side[1].view.height = side[0].image.height;
    if (!status) status = draw(c, &side[1]);
    if (!status) status = compare(c, path, layout, side);
    for (int i = 0; i < 2; i++) relight_image_finish(&side[i].image);
    return status;
}

int room_compare(struct room_call *c)
{
    const char *path = c->options->output;
    const char *dot = path ? strrchr(path, '.') : NULL;
    struct side side[2] = {0};
    enum compare_layout layout;
    int status = read_layout(c, &layout);
    if (path && (!dot || strcmp(dot, ".png")))
        return report_usage(c->options, "-o %s: expected a name that ends in .png", path);
    if (!status) status = read_side(c, c->n_word > 1 ? c->word[1] : "now", &side[1]);
    if (!status)
        status = c->n_word ? read_side(c, c->word[0], &side[0])
                           : decision_side(c, &side[0], &side[1]);
    if (!status) status = compare_sides(c, path, layout, side);
    return status == ROOM_NOT_DRAWN ? room_failed(c) : status;
}

int room_write_change(struct room_call *c, uint64_t decision, const char *path)
{
    struct side side[2] = {{.view = {.decision = decision}}, {.name = "now"}};
    snprintf(side[0].name, sizeof side[0].name, "decision %llu", (unsigned long long)decision);
    return compare_sides(c, path, COMPARE_SHEET, side);
}
