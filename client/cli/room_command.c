// SPDX-License-Identifier: MIT
// relight room: what people do in a review room.
#include "room.h"

#include "common/room_name.h"
#include "frame.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

int room_failed(struct room_call *c)
{
    return report_error(c->options, &c->error);
}

cJSON *room_state(struct room_call *c)
{
    char *text;
    if (relight_room_state(c->client, c->room, &text, NULL, &c->error)) {
        room_failed(c);
        return NULL;
    }
    cJSON *state = cJSON_Parse(text);
    free(text);
    if (!state) report_usage(c->options, "the room's state is no JSON");
    return state;
}

cJSON *room_action(const char *field, cJSON *value)
{
    cJSON *action = cJSON_CreateObject();
    cJSON_AddItemToObject(action, field, value);
    return action;
}

int room_act(struct room_call *c, cJSON *action, struct relight_room_edited *out)
{
    char *text = cJSON_PrintUnformatted(action);
    cJSON_Delete(action);
    int status = relight_room_edit(c->client, c->room, text ? text : "", c->me, out, &c->error);
    free(text);
    return status ? room_failed(c) : EXIT_DONE;
}

// An action whose answer is all there is to say.
static int simple(struct room_call *c, cJSON *action, const char *done)
{
    struct relight_room_edited edited;
    int status = room_act(c, action, &edited);
    if (status) return status;
    if (c->options->json) {
        cJSON *json = cJSON_CreateObject();
        cJSON_AddNumberToObject(json, "sequence", (double)edited.sequence);
        print_json(json);
    } else {
        printf("%s (%llu)\n", done, (unsigned long long)edited.sequence);
    }
    return EXIT_DONE;
}

// ---- rooms

static int create(struct room_call *c)
{
    cJSON *scene, *parts;
    char room[RELIGHT_ROOM];
    int status = room_scene(c, &scene, &parts);
    if (status) return status;
    char *text = cJSON_PrintUnformatted(scene);
    cJSON_Delete(scene);
    cJSON_Delete(parts);
    status = relight_room_create(c->client, c->word[0], text, c->me, room, &c->error);
    free(text);
    if (status) return room_failed(c);
    if (c->options->json) {
        cJSON *json = cJSON_CreateObject();
        cJSON_AddStringToObject(json, "room", room);
        print_json(json);
    } else {
        puts(room);
    }
    return EXIT_DONE;
}

// An action as relight.proto has it, for programs and for what no verb does.
static int act(struct room_call *c)
{
    cJSON *action = cJSON_Parse(c->word[0]);
    if (!cJSON_IsObject(action)) {
        cJSON_Delete(action);
        return report_usage(c->options, "act: expected a RoomAction as JSON, such as "
                                        "{\"rename\":{\"name\":\"Bunny\"}}");
    }
    return simple(c, action, "done");
}

static int rename_room(struct room_call *c)
{
    cJSON *m = cJSON_CreateObject();
    cJSON_AddStringToObject(m, "name", c->word[0]);
    return simple(c, room_action("rename", m), "renamed");
}

static int set_closed(struct room_call *c, bool closed)
{
    cJSON *m = cJSON_CreateObject();
    cJSON_AddBoolToObject(m, "closed", closed);
    return simple(c, room_action("close", m), closed ? "closed" : "open");
}

static int close_room(struct room_call *c)
{
    return set_closed(c, true);
}

static int open_room(struct room_call *c)
{
    return set_closed(c, false);
}

static int backup(struct room_call *c)
{
    uint64_t size;
    if (!c->options->output) return report_usage(c->options, "backup: -o FILE is missing");
    if (relight_room_backup(c->client, c->options->output, progress_bar, NULL, &size,
                            &c->error))
        return room_failed(c);
    progress_clear();
    if (c->options->json) {
        cJSON *json = cJSON_CreateObject();
        cJSON_AddStringToObject(json, "file", c->options->output);
        cJSON_AddNumberToObject(json, "bytes", (double)size);
        print_json(json);
    } else {
        printf("%s: %llu bytes\n", c->options->output, (unsigned long long)size);
    }
    return EXIT_DONE;
}

// ---- people

static int set_member(struct room_call *c)
{
    const struct options *o = c->options;
    cJSON *m = cJSON_CreateObject();
    cJSON_AddStringToObject(m, "by", c->word[0]);
    cJSON_AddStringToObject(m, "role", o->role ? o->role : "reviewer");
    return simple(c, room_action("member", m), o->role ? o->role : "reviewer");
}

static int invite(struct room_call *c)
{
    const struct options *o = c->options;
    struct relight_room_edited edited;
    cJSON *m = cJSON_CreateObject();
    cJSON_AddStringToObject(m, "role", o->role ? o->role : "viewer");
    if (c->n_word) cJSON_AddStringToObject(m, "name", c->word[0]);
    if (o->token_order.lifetime_s)
        cJSON_AddNumberToObject(m, "expires_s",
                                (double)time(NULL) + (double)o->token_order.lifetime_s);
    int status = room_act(c, room_action("invite", m), &edited);
    if (status) return status;
    if (o->json) {
        cJSON *json = cJSON_CreateObject();
        cJSON_AddStringToObject(json, "room", c->room);
        cJSON_AddStringToObject(json, "token", edited.secret);
        print_json(json);
        return EXIT_DONE;
    }
    printf("%s\n", edited.secret);
    fprintf(
        stderr,
        "relight: this is the only time that the invitation is shown. The guest sends it as "
        "token: RELIGHT_TOKEN=... relight room show %s\n",
        c->room);
    return EXIT_DONE;
}

static int revoke(struct room_call *c)
{
    return simple(c, room_action("revoke", cJSON_CreateString(c->word[0])), "revoked");
}

// ---- the scene

// Fields of the shade and the picture that the command does not set keep the room's values.
static int keep_fields(struct room_call *c, cJSON *scene)
{
    static const char *const part[] = {"shade", "picture"};
    cJSON *state = NULL;
    for (int i = 0; i < 2; i++) {
        cJSON *own = cJSON_GetObjectItem(scene, part[i]);
        const cJSON *field;
        if (!own) continue;
        if (!state && !(state = room_state(c))) return EXIT_FAILED;
        cJSON_ArrayForEach(field, list_of(list_of(state, "scene"), part[i]))
        {
            if (!cJSON_GetObjectItem(own, field->string))
                cJSON_AddItemToObject(own, field->string, cJSON_Duplicate(field, 1));
        }
    }
    cJSON_Delete(state);
    return EXIT_DONE;
}

static int set_scene(struct room_call *c)
{
    cJSON *scene, *parts;
    int status = room_scene(c, &scene, &parts);
    if (status) return status;
    if ((status = keep_fields(c, scene))) {
        cJSON_Delete(scene);
        cJSON_Delete(parts);
        return status;
    }
    cJSON *m = cJSON_CreateObject();
    cJSON_AddItemToObject(m, "scene", scene);
    cJSON_AddItemToObject(m, "parts", parts);
    if (cJSON_GetArraySize(parts)) return simple(c, room_action("scene", m), "changed");
    cJSON_Delete(m);
    return report_usage(c->options, "scene: nothing to change: --model, --env, --material, "
                                    "--engine, --camera, --size, --exposure, …");
}

static int undo(struct room_call *c)
{
    return simple(c, room_action("undo", cJSON_CreateObject()), "undone");
}

static int redo(struct room_call *c)
{
    return simple(c, room_action("redo", cJSON_CreateObject()), "redone");
}

static int save(struct room_call *c)
{
    cJSON *m = cJSON_CreateObject();
    if (c->n_word) cJSON_AddStringToObject(m, "note", c->word[0]);
    return simple(c, room_action("save", m), "saved");
}

static int variant(struct room_call *c)
{
    if (c->options->n_material)
        return report_usage(c->options, "variant: its --material is for all objects: leave "
                                        "OBJECT= out");
    cJSON *m = cJSON_CreateObject();
    cJSON_AddStringToObject(m, "name", c->word[0]);
    cJSON_AddStringToObject(m, "material", c->options->material ? c->options->material : "");
    return simple(c, room_action("variant", m),
                  c->options->material ? "variant" : "variant removed");
}

// ---- pins

// The point in the model's own units, from the triangle's corners.
static void add_position(struct room_call *c, cJSON *at, const char *model, uint32_t triangle,
                         const float b[2])
{
    static const char *const axis[] = {"x", "y", "z"};
    struct relight_geometry g = {0};
    if (!*model || relight_geometry(c->client, model, true, &g, &c->error)) return;
    if (triangle < g.n_triangle) {
        cJSON *position = cJSON_AddObjectToObject(at, "position");
        const uint32_t *corner = g.triangle[triangle];
        for (int k = 0; k < 3; k++) {
            float x = (1 - b[0] - b[1]) * g.position[corner[0]][k] +
                      b[0] * g.position[corner[1]][k] + b[1] * g.position[corner[2]][k];
            add_float(position, axis[k], x);
        }
    }
    relight_geometry_finish(&g);
}

// "OBJECT,TRIANGLE,B1,B2"
static int read_point(struct room_call *c, const char *model, cJSON **out)
{
    unsigned object, triangle;
    float b[2];
    int used = 0;
    const char *text = c->options->at;
    if (!text) return report_usage(c->options, "pin: --at OBJECT,TRIANGLE,B1,B2 is missing");
    if (sscanf(text, "%u,%u,%f,%f%n", &object, &triangle, b, b + 1, &used) != 4 || text[used])
        return report_usage(c->options, "--at %s: expected OBJECT,TRIANGLE,B1,B2", text);
    *out = cJSON_CreateObject();
    cJSON_AddNumberToObject(*out, "object", object);
    cJSON_AddNumberToObject(*out, "triangle", triangle);
    add_float(*out, "b1", b[0]);
    add_float(*out, "b2", b[1]);
    add_position(c, *out, model, triangle, b);
    return EXIT_DONE;
}

// The room's scene, the SHA-256 of its picture, and what that was made from (NULL: an older
// daemon does not say it). A scene that changes meanwhile is drawn again.
static int see(struct room_call *c, cJSON **scene, char hash[65], cJSON **drawn)
{
    for (int tries = 0; tries < 5; tries++) {
        struct relight_room_view view = {0};
        struct relight_image image;
        struct relight_sha256 sha;
        cJSON *before = room_state(c);
        if (!before) return EXIT_FAILED;
        if (relight_room_picture(c->client, c->room, &view, &image, &c->error)) {
            cJSON_Delete(before);
            return room_failed(c);
        }
        relight_sha256_init(&sha);
        relight_sha256_add(&sha, image.data, image.n_byte);
        relight_sha256_hex(&sha, hash);
        cJSON *made = *image.mesh_hash ? cJSON_CreateObject() : NULL;
        if (made) cJSON_AddStringToObject(made, "mesh_hash", image.mesh_hash);
        if (made) cJSON_AddStringToObject(made, "bake_hash", image.bake_hash);
        relight_image_finish(&image);
        cJSON *after = room_state(c);
        bool same =
            after && cJSON_Compare(list_of(before, "scene"), list_of(after, "scene"), 1);
        *scene = same ? cJSON_DetachItemFromObject(after, "scene") : NULL;
        cJSON_Delete(before);
        cJSON_Delete(after);
        *drawn = same ? made : NULL;
        if (!same) cJSON_Delete(made);
        if (!after) return EXIT_FAILED;
        if (same) return EXIT_DONE;
    }
    return report_usage(c->options, "the room's scene changes all the time: try again");
}

static int pin(struct room_call *c)
{
    char hash[65];
    cJSON *scene, *drawn, *at = NULL;
    int status = see(c, &scene, hash, &drawn);
    if (status) return status;
    cJSON_Delete(drawn); // a pin is about the surface
    if ((status = read_point(c, text_of(scene, "model"), &at))) {
        cJSON_Delete(scene);
        return status;
    }
    cJSON *m = cJSON_CreateObject();
    cJSON_AddStringToObject(m, "text", c->word[0]);
    cJSON_AddItemToObject(m, "at", at);
    cJSON_AddItemToObject(m, "scene", scene);
    cJSON_AddStringToObject(m, "picture_hash", hash);
    return simple(c, room_action("pin", m), "pin");
}

static int number_usage(struct room_call *c, const char *word)
{
    return report_usage(c->options, "%s: expected a number that `relight room show` prints",
                        word);
}

static int note(struct room_call *c, const char *field, const char *done)
{
    uint64_t target;
    if (!whole_word(c->word[0], &target)) return number_usage(c, c->word[0]);
    cJSON *m = cJSON_CreateObject();
    cJSON_AddNumberToObject(m, "target", (double)target);
    cJSON_AddStringToObject(m, "text", c->word[1]);
    return simple(c, room_action(field, m), done);
}

static int reply(struct room_call *c)
{
    return note(c, "reply", "note");
}

static int change(struct room_call *c)
{
    return note(c, "change", "changed");
}

static int set_status(struct room_call *c, bool resolved)
{
    uint64_t target;
    if (!whole_word(c->word[0], &target)) return number_usage(c, c->word[0]);
    cJSON *m = cJSON_CreateObject();
    cJSON_AddNumberToObject(m, "pin", (double)target);
    cJSON_AddBoolToObject(m, "resolved", resolved);
    return simple(c, room_action("status", m), resolved ? "resolved" : "open");
}

static int resolve(struct room_call *c)
{
    return set_status(c, true);
}

static int reopen(struct room_call *c)
{
    return set_status(c, false);
}

static int erase(struct room_call *c)
{
    uint64_t target;
    if (!whole_word(c->word[0], &target)) return number_usage(c, c->word[0]);
    cJSON *m = cJSON_CreateObject();
    cJSON_AddNumberToObject(m, "target", (double)target);
    return simple(c, room_action("erase", m), "erased");
}

// ---- decisions

static int decide(struct room_call *c, bool approve)
{
    char hash[65];
    cJSON *scene, *drawn;
    int status = see(c, &scene, hash, &drawn);
    if (status) return status;
    cJSON *m = cJSON_CreateObject();
    cJSON_AddBoolToObject(m, "approve", approve);
    if (c->n_word) cJSON_AddStringToObject(m, "note", c->word[0]);
    cJSON_AddItemToObject(m, "scene", scene);
    cJSON_AddStringToObject(m, "picture_hash", hash);
    if (drawn) cJSON_AddItemToObject(m, "drawn", drawn);
    return simple(c, room_action("decide", m), approve ? "approved" : "rejected");
}

static int approve(struct room_call *c)
{
    return decide(c, true);
}

static int reject(struct room_call *c)
{
    return decide(c, false);
}

// ---- the verbs

static const struct verb {
    const char *name;
    bool has_room;
    unsigned least, most; // words after it
    const char *usage;
    int (*run)(struct room_call *c);
} verbs[] = {
    {"create", false, 1, 1, "NAME", create},
    {"list", false, 0, 0, "", room_list},
    {"backup", false, 0, 0, "-o FILE", backup},
    {"show", true, 0, 1, "ROOM [PIN]", room_show},
    {"anchors", true, 0, 0, "ROOM", room_anchors},
    {"act", true, 1, 1, "ROOM JSON", act},
    {"compare", true, 0, 2, "ROOM [REVISION [REVISION]]", room_compare},
    {"log", true, 0, 0, "ROOM", room_log},
    {"watch", true, 0, 0, "ROOM", room_watch},
    {"rename", true, 1, 1, "ROOM NAME", rename_room},
    {"close", true, 0, 0, "ROOM", close_room},
    {"open", true, 0, 0, "ROOM", open_room},
    {"member", true, 1, 1, "ROOM PRINCIPAL", set_member},
    {"invite", true, 0, 1, "ROOM [NAME]", invite},
    {"revoke", true, 1, 1, "ROOM INVITATION", revoke},
    {"scene", true, 0, 0, "ROOM", set_scene},
    {"undo", true, 0, 0, "ROOM", undo},
    {"redo", true, 0, 0, "ROOM", redo},
    {"save", true, 0, 1, "ROOM [NOTE]", save},
    {"variant", true, 1, 1, "ROOM NAME", variant},
    {"pin", true, 1, 1, "ROOM TEXT --at OBJECT,TRIANGLE,B1,B2", pin},
    {"reply", true, 2, 2, "ROOM PIN TEXT", reply},
    {"change", true, 2, 2, "ROOM NOTE TEXT", change},
    {"resolve", true, 1, 1, "ROOM PIN", resolve},
    {"reopen", true, 1, 1, "ROOM PIN", reopen},
    {"erase", true, 1, 1, "ROOM NUMBER", erase},
    {"approve", true, 0, 1, "ROOM [NOTE]", approve},
    {"reject", true, 0, 1, "ROOM [NOTE]", reject},
    {"export", true, 0, 0, "ROOM -o FOLDER", room_export},
    {"import", true, 1, 1, "ROOM FILE.bcf", room_import},
};
enum { N_VERB = sizeof verbs / sizeof *verbs };

static int unknown_verb(const struct options *o)
{
    char all[512] = "";
    for (int i = 0; i < N_VERB; i++) {
        size_t n = strlen(all);
        snprintf(all + n, sizeof all - n, "%s%s", i ? ", " : "", verbs[i].name);
    }
    return report_usage(o, "%s: expected one of %s", o->target, all);
}

static int find_room(struct room_call *c, const char *text)
{
    if (room_is_id(text)) {
        strcpy(c->room, text);
        return EXIT_DONE;
    }
    return room_of_word(c->client, text, c->room, &c->error) ? room_failed(c) : EXIT_DONE;
}

int run_room(struct relight_client *client, struct options *options)
{
    struct room_call c = {.client = client, .options = options, .me = options->as};
    if (!c.me) c.me = getenv("USER");
    if (!c.me) c.me = "";
    c.word = options->words;
    c.n_word = options->n_word;
    for (int i = 0; i < N_VERB; i++) {
        const struct verb *v = &verbs[i];
        if (strcmp(v->name, options->target)) continue;
        unsigned lead = v->has_room ? 1 : 0;
        if (c.n_word < v->least + lead || c.n_word > v->most + lead)
            return report_usage(options, "expected: relight room %s %s", v->name, v->usage);
        c.word += lead;
        c.n_word -= lead;
        int status = lead ? find_room(&c, options->words[0]) : EXIT_DONE;
        return status ? status : v->run(&c);
    }
    return unknown_verb(options);
}
