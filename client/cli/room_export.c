// SPDX-License-Identifier: MIT
// relight room export: a room as files; import: pins of a BCF file become pins of a room.
#include "room.h"

#include <dirent.h>
#include <errno.h>
#include <fnmatch.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static int file_failed(struct room_call *c, const char *path)
{
    c->error = (struct relight_error){.code = RELIGHT_E_FILE};
    snprintf(c->error.text, sizeof c->error.text, "%.300s: %s", path, strerror(errno));
    return room_failed(c);
}

static int make_folder(struct room_call *c, const char *path)
{
    return mkdir(path, 0777) && errno != EEXIST ? file_failed(c, path) : EXIT_DONE;
}

static void path_in(struct room_call *c, char out[4096], const char *name)
{
    snprintf(out, 4096, "%s/%s", c->options->output, name);
}

static int write_text(struct room_call *c, const char *name, const char *text)
{
    char path[4096];
    path_in(c, path, name);
    return write_file(c->options, path, text, strlen(text));
}

static int write_json(struct room_call *c, const char *name, const cJSON *json)
{
    char *text = cJSON_Print(json);
    if (!text) return report_usage(c->options, "not enough memory");
    int status = write_text(c, name, text);
    free(text);
    return status;
}

// ---- an earlier export

static const char *const old_pictures[] = {"pin-[0-9]*.png", "decision-[0-9]*.png", NULL};
static const char *const old_materials[] = {"material.json",
                                            "material.gltf",
                                            "material.mtlx",
                                            "material-*.json",
                                            "material-*.gltf",
                                            "material-*.mtlx",
                                            NULL};

static void remove_matching(const char *folder, const char *const *patterns)
{
    DIR *dir = opendir(folder);
    for (const struct dirent *e; dir && (e = readdir(dir));)
        for (const char *const *p = patterns; *p; p++)
            if (!fnmatch(*p, e->d_name, 0)) unlinkat(dirfd(dir), e->d_name, 0);
    if (dir) closedir(dir);
}

// What the room no longer has (a change that was undone, a pin that was erased, a
// material that was rejected) would be taken for a part of this export.
static void remove_earlier(struct room_call *c)
{
    char path[4096];
    path_in(c, path, "room.json");
    if (access(path, F_OK)) return; // nothing in it is ours
    remove_matching(c->options->output, old_materials);
    path_in(c, path, "pictures");
    remove_matching(path, old_pictures);
}

// ---- pictures

int room_left_out(struct room_call *c, const char *name)
{
    static const int of_it[] = {
        RELIGHT_E_NOT_FOUND, RELIGHT_E_LIMIT,       RELIGHT_E_FORMAT,      RELIGHT_E_MISMATCH,
        RELIGHT_E_NOT_READY, RELIGHT_E_UNSUPPORTED, RELIGHT_E_OUT_OF_RANGE};
    for (size_t i = 0; i < sizeof of_it / sizeof *of_it; i++) {
        if (c->error.code != of_it[i]) continue;
        fprintf(stderr, "relight: %s is left out: %s\n", name, c->error.text);
        c->n_left_out++;
        return EXIT_DONE;
    }
    return room_failed(c);
}

// *drawn: whether it was; the export goes on without it.
static int write_picture(struct room_call *c, const char *name,
                         const struct relight_room_view *view, bool *drawn)
{
    struct relight_image image;
    char path[4096];
    path_in(c, path, name);
    *drawn = !relight_room_picture(c->client, c->room, view, &image, &c->error);
    if (!*drawn) return room_left_out(c, name);
    int status = write_file(c->options, path, image.data, image.n_byte);
    relight_image_finish(&image);
    return status;
}

// Of a decision about another scene or bake than the room shows now: both, and where they
// differ.
static int write_change(struct room_call *c, const struct room_now *now, const cJSON *decision)
{
    char name[80], path[4096];
    double sequence = number_of(list_of(decision, "stamp"), "sequence");
    if (room_stands(decision, now)) return EXIT_DONE;
    snprintf(name, sizeof name, "pictures/decision-%.0f-now.png", sequence);
    path_in(c, path, name);
    int status = room_write_change(c, (uint64_t)sequence, path);
    return status == ROOM_NOT_DRAWN ? room_left_out(c, name) : status;
}

static int write_strokes(struct room_call *c, const cJSON *state, double pin)
{
    char name[80], path[4096];
    snprintf(name, sizeof name, "pictures/pin-%.0f-strokes.png", pin);
    path_in(c, path, name);
    return room_write_strokes(c, state, pin, path);
}

static int write_pictures(struct room_call *c, const cJSON *state)
{
    const cJSON *item;
    char name[80];
    int status = EXIT_DONE;
    struct room_now now;
    room_now(c, state, &now);
    for (int kind = 0; kind < 2; kind++)
        cJSON_ArrayForEach(item, list_of(state, kind ? "decisions" : "pins"))
        {
            uint64_t sequence = (uint64_t)number_of(list_of(item, "stamp"), "sequence");
            struct relight_room_view view = {0};
            if (kind) view.decision = sequence;
            else view.pin = sequence;
            snprintf(name, sizeof name, "pictures/%s-%llu.png", kind ? "decision" : "pin",
                     (unsigned long long)sequence);
            bool drawn = false;
            if (!status) status = write_picture(c, name, &view, &drawn);
            if (drawn && !status && !kind) status = write_strokes(c, state, (double)sequence);
            if (drawn && !status && kind) status = write_change(c, &now, item);
        }
    return status;
}

// ---- decisions

// A cell that a spreadsheet would take for a formula begins with an apostrophe.
static void put_cell(FILE *out, const char *text, bool last)
{
    fputc('"', out);
    if (*text && strchr("=+-@\t\r", *text)) fputc('\'', out);
    for (; *text; text++) {
        if (*text == '"') fputc('"', out);
        fputc(*text, out);
    }
    fputs(last ? "\"\r\n" : "\",", out);
}

static int write_decisions(struct room_call *c, const cJSON *state)
{
    char *text = NULL, when[32], number[32];
    size_t n;
    const cJSON *d;
    FILE *out = open_memstream(&text, &n);
    if (!out) return report_usage(c->options, "not enough memory");
    fputs("decision,time,name,principal,verdict,revision,note,hash,picture,model,bake\r\n",
          out);
    cJSON_ArrayForEach(d, list_of(state, "decisions"))
    {
        const cJSON *stamp = list_of(d, "stamp"), *seen = list_of(d, "seen");
        print_utc(when, number_of(stamp, "time_us"));
        fprintf(out, "%.0f,%s,", number_of(stamp, "sequence"), when);
        put_cell(out, text_of(stamp, "name"), false);
        put_cell(out, text_of(stamp, "by"), false);
        put_cell(out, cJSON_IsTrue(list_of(d, "approve")) ? "approved" : "rejected", false);
        snprintf(number, sizeof number, "%.0f", number_of(seen, "revision"));
        put_cell(out, number, false);
        put_cell(out, text_of(d, "note"), false);
        put_cell(out, text_of(d, "hash"), false);
        put_cell(out, text_of(seen, "picture_hash"), false);
        put_cell(out, text_of(seen, "model"), false);
        put_cell(out, text_of(seen, "bake_hash"), true);
    }
    int status = fclose(out) ? report_usage(c->options, "not enough memory")
                             : write_text(c, "decisions.csv", text);
    free(text);
    return status;
}

// ---- the log

static int write_log(struct room_call *c)
{
    cJSON *all = cJSON_CreateArray();
    for (uint64_t after = 0, last = 1; last; after = last) {
        char *text;
        if (relight_room_log(c->client, c->room, after, &text, &last, &c->error)) {
            cJSON_Delete(all);
            return room_failed(c);
        }
        cJSON *part = cJSON_Parse(text), *events = cJSON_GetObjectItem(part, "events");
        free(text);
        while (cJSON_GetArraySize(events))
            cJSON_AddItemToArray(all, cJSON_DetachItemFromArray(events, 0));
        cJSON_Delete(part);
    }
    int status = write_json(c, "history.json", all);
    cJSON_Delete(all);
    return status;
}

int room_export(struct room_call *c)
{
    char path[4096];
    if (!c->options->output) return report_usage(c->options, "export: -o FOLDER is missing");
    if (strlen(c->options->output) > sizeof path - 100)
        return report_usage(c->options, "-o: the path is too long");
    cJSON *state = room_state(c);
    if (!state) return EXIT_FAILED;
    path_in(c, path, "pictures");
    int status = make_folder(c, c->options->output);
    if (!status) status = make_folder(c, path);
    if (!status) remove_earlier(c);
    if (!status) status = write_json(c, "room.json", state);
    if (!status) status = write_log(c);
    if (!status) status = write_pictures(c, state);
    if (!status) status = write_decisions(c, state);
    path_in(c, path, "pins.bcf");
    if (!status) status = bcf_write(c, state, path);
    if (!status) status = export_material(c, state);
    if (!status && !c->options->json)
        printf("%s: %d pins, %d decisions\n", c->options->output,
               cJSON_GetArraySize(list_of(state, "pins")),
               cJSON_GetArraySize(list_of(state, "decisions")));
    cJSON_Delete(state);
    if (status || !c->n_left_out) return status;
    fprintf(stderr, "relight: warning: the export is not complete: %u parts are left out\n",
            c->n_left_out);
    return EXIT_FAILED;
}

// ---- import

// State for topics that another program wrote. They name no point of the surface; their view
// says where the pin belongs.
struct placing {
    struct room_call *c;
    cJSON *state; // NULL: not asked for yet
    struct relight_geometry geometry;
    unsigned n;       // pins that their view placed
    unsigned n_topic; // that are in the room
    unsigned n_cut;   // notes that were longer than the room takes
};
enum { MOST_NOTE = 8192 }; // bytes that a room takes

// An imported note belongs to the importer; its first author and date are kept as text.
static cJSON *note_text(struct placing *p, const cJSON *author, const cJSON *date,
                        const char *text)
{
    char all[MOST_NOTE + 1], from[128];
    const char *a = cJSON_GetStringValue(author), *d = cJSON_GetStringValue(date);
    if (!a) a = "?";
    if (!d) d = "?";
    int n = snprintf(from, sizeof from, "\n(%.*s, %.*s)", (int)whole_characters(a, 64), a,
                     (int)whole_characters(d, 32), d);
    size_t kept = whole_characters(text, MOST_NOTE - (size_t)n);
    if (text[kept]) p->n_cut++;
    snprintf(all, sizeof all, "%.*s%s", (int)kept, text, from);
    return cJSON_CreateString(all);
}

static int begin_placing(struct placing *p)
{
    struct room_call *c = p->c;
    if (p->state) return EXIT_DONE;
    if (!(p->state = room_state(c))) return EXIT_FAILED;
    const char *model = text_of(list_of(p->state, "scene"), "model");
    if (!*model)
        return report_usage(c->options, "the room's scene has no model to place pins on: "
                                        "relight room scene ROOM --model MODEL");
    return relight_geometry(c->client, model, true, &p->geometry, &c->error) ? room_failed(c)
                                                                             : EXIT_DONE;
}

static void end_placing(struct placing *p)
{
    if (p->geometry.owner) relight_geometry_finish(&p->geometry);
    cJSON_Delete(p->state);
}

// The point that the view shows, and the room's scene seen by its camera. A topic without a
// view is pinned to the first triangle.
static int place_by_view(struct placing *p, const cJSON *topic, cJSON *pin)
{
    struct bcf_view view;
    struct room_point at = {0};
    struct relight_camera camera;
    bool has_view = bcf_view_of(list_of(topic, "view"), &view);
    int status = has_view ? begin_placing(p) : EXIT_DONE;
    if (status) return status;
    if (!has_view || !room_look(&p->geometry, &view, &at, &camera)) {
        cJSON_AddItemToObject(pin, "at", cJSON_CreateObject());
        return EXIT_DONE;
    }
    cJSON *scene = cJSON_Duplicate(list_of(p->state, "scene"), 1);
    cJSON_DeleteItemFromObject(scene, "camera");
    room_add_camera(scene, &camera);
    cJSON_AddItemToObject(pin, "at", room_point_json(&at));
    cJSON_AddItemToObject(pin, "scene", scene);
    p->n++;
    return EXIT_DONE;
}

static int import_pin(struct placing *p, const cJSON *topic, uint64_t *pin)
{
    const cJSON *own = list_of(topic, "relight"), *scene = list_of(own, "scene");
    const cJSON *at = list_of(list_of(own, "pin"), "at");
    const char *text = text_of(topic, "Description");
    struct relight_room_edited edited;
    int status = EXIT_DONE;
    cJSON *m = cJSON_CreateObject();
    if (!*text) text = text_of(topic, "Title");
    cJSON_AddItemToObject(
        m, "text",
        note_text(p, list_of(topic, "CreationAuthor"), list_of(topic, "CreationDate"), text));
    if (at) cJSON_AddItemToObject(m, "at", cJSON_Duplicate(at, 1));
    else status = place_by_view(p, topic, m);
    if (at && scene) cJSON_AddItemToObject(m, "scene", cJSON_Duplicate(scene, 1));
    if (status) {
        cJSON_Delete(m);
        return status;
    }
    status = room_act(p->c, room_action("pin", m), &edited);
    *pin = edited.sequence;
    return status;
}

static int import_notes(struct placing *p, const cJSON *topic, uint64_t pin)
{
    struct room_call *c = p->c;
    const cJSON *comment, *first = cJSON_GetArrayItem(list_of(topic, "comments"), 0);
    int status = EXIT_DONE;
    cJSON_ArrayForEach(comment, list_of(topic, "comments"))
    {
        const char *text = text_of(comment, "Comment");
        // Our own first comment is the pin's text.
        if (!*text || (comment == first && !strcmp(text, text_of(topic, "Description"))))
            continue;
        cJSON *m = cJSON_CreateObject();
        cJSON_AddNumberToObject(m, "target", (double)pin);
        cJSON_AddItemToObject(
            m, "text",
            note_text(p, list_of(comment, "Author"), list_of(comment, "Date"), text));
        if (!status) status = room_act(c, room_action("reply", m), NULL);
        else cJSON_Delete(m);
    }
    const char *word = text_of(topic, "status");
    if (!status && (!strcmp(word, "Closed") || !strcmp(word, "Resolved"))) {
        cJSON *m = cJSON_CreateObject();
        cJSON_AddNumberToObject(m, "pin", (double)pin);
        cJSON_AddBoolToObject(m, "resolved", 1);
        status = room_act(c, room_action("status", m), NULL);
    }
    return status;
}

static void say_import(const struct placing *p, int n, int status)
{
    if (!status && !p->c->options->json) {
        printf("%d pins", n);
        if (p->n) printf(", placed by their view: %u", p->n);
        putchar('\n');
    }
    if (status)
        fprintf(stderr, "relight: %u of %d topics are in the room as a whole\n", p->n_topic, n);
    if (p->n_cut)
        fprintf(stderr, "relight: warning: %u notes are cut: a room takes %d bytes\n", p->n_cut,
                MOST_NOTE);
}

int room_import(struct room_call *c)
{
    cJSON *topics, *topic;
    struct placing placing = {.c = c};
    int status = bcf_read(c, c->word[0], &topics);
    if (status) return status;
    cJSON_ArrayForEach(topic, topics)
    {
        uint64_t pin;
        if (!status) status = import_pin(&placing, topic, &pin);
        if (!status) status = import_notes(&placing, topic, pin);
        if (!status) placing.n_topic++;
    }
    say_import(&placing, cJSON_GetArraySize(topics), status);
    end_placing(&placing);
    cJSON_Delete(topics);
    return status;
}
