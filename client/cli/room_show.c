// SPDX-License-Identifier: MIT
// Rooms as text: lists, a room with its pins and decisions, its log, what happens in it; and
// pictures of its scenes.
#include "room.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static int bad_json(struct room_call *c)
{
    return report_usage(c->options, "the daemon's answer is no JSON");
}

int room_list(struct room_call *c)
{
    char *text, when[32];
    const cJSON *room;
    if (relight_room_list(c->client, &text, &c->error)) return room_failed(c);
    cJSON *all = cJSON_Parse(text);
    free(text);
    if (!all) return bad_json(c);
    if (cJSON_IsTrue(list_of(all, "more")))
        fprintf(stderr,
                "relight: warning: these are the rooms that changed last; there are more\n");
    if (c->options->json) {
        print_json(cJSON_DetachItemFromObject(all, "rooms"));
        cJSON_Delete(all);
        return EXIT_DONE;
    }
    cJSON_ArrayForEach(room, list_of(all, "rooms"))
    {
        print_time(when, number_of(room, "changed_us"));
        printf("%.8s  %-8s  %s  %4.0f events", text_of(room, "room"), text_of(room, "role"),
               when, number_of(room, "sequence"));
        if (number_of(room, "present") > 0) printf("  %.0f here", number_of(room, "present"));
        if (cJSON_IsTrue(list_of(room, "closed"))) printf("  closed");
        printf("  %s\n", escape(text_of(room, "name")).text);
    }
    cJSON_Delete(all);
    return EXIT_DONE;
}

// ---- one room

static void print_scene(const cJSON *state, unsigned now)
{
    const cJSON *scene = list_of(state, "scene"), *material = list_of(scene, "material");
    printf("scene: model %.16s, lights: %d",
           *text_of(scene, "model") ? text_of(scene, "model") : "none",
           cJSON_GetArraySize(list_of(scene, "lights")));
    if (material)
        printf(", material %s", cJSON_IsObject(material)
                                    ? "of its own"
                                    : escape(text_of(scene, "material")).text);
    if (now) printf(", revision %u\n", now);
    else printf(", not saved\n");
}

static void print_note(const cJSON *note, const char *lead)
{
    char when[32];
    const cJSON *stamp = list_of(note, "stamp");
    if (!*text_of(note, "text")) return;
    print_time(when, number_of(stamp, "time_us"));
    printf("%s%s  %s: ", lead, when, escape(author_of(stamp)).text);
    print_text(stdout, text_of(note, "text"));
    putchar('\n');
}

static void print_pin(const cJSON *pin, bool all)
{
    const cJSON *notes = list_of(pin, "notes"), *note;
    int n = cJSON_GetArraySize(notes), i = 0;
    printf("pin %.0f  %s  revision %.0f  ", number_of(list_of(pin, "stamp"), "sequence"),
           cJSON_IsTrue(list_of(pin, "resolved")) ? "resolved" : "open",
           number_of(list_of(pin, "seen"), "revision"));
    cJSON_ArrayForEach(note, notes)
    {
        if (i && !all) break;
        print_note(note, i++ ? "    " : "");
    }
    if (!all && n > 1) printf("    replies: %d\n", n - 1);
}

static void print_decision(const cJSON *decision, const struct room_now *now)
{
    char when[32];
    const char *model = room_model_change(decision, now);
    const cJSON *stamp = list_of(decision, "stamp");
    double at = number_of(list_of(decision, "seen"), "revision");
    print_time(when, number_of(stamp, "time_us"));
    printf("decision %.0f  %s  %s %s at revision %.0f", number_of(stamp, "sequence"), when,
           escape(author_of(stamp)).text,
           cJSON_IsTrue(list_of(decision, "approve")) ? "approved" : "rejected", at);
    if (!now->revision) printf(", changed since");
    else if (at < now->revision || at > now->revision) printf(", now at %u", now->revision);
    if (*model) printf("; %s", model);
    if (*text_of(decision, "note")) printf(": %s", escape(text_of(decision, "note")).text);
    putchar('\n');
}

static void print_people(const cJSON *state)
{
    const cJSON *m;
    char when[32];
    cJSON_ArrayForEach(m, list_of(state, "members"))
        printf("%s  %s  %s\n", text_of(m, "role"), escape(text_of(m, "by")).text,
               escape(text_of(m, "name")).text);
    cJSON_ArrayForEach(m, list_of(state, "invites"))
    {
        print_time(when, number_of(m, "expires_s") * 1e6);
        printf("guest %s  %s  %s  %s%s\n", text_of(m, "id"), text_of(m, "role"),
               escape(text_of(m, "name")).text,
               cJSON_IsTrue(list_of(m, "revoked")) ? "revoked" : "until ",
               cJSON_IsTrue(list_of(m, "revoked")) ? ""
               : number_of(m, "expires_s") > 0     ? when
                                                   : "revoked");
    }
}

static void print_room(const cJSON *state, const struct room_now *now)
{
    const cJSON *item;
    printf("%s  %s  event %.0f%s\n", escape(text_of(state, "name")).text,
           text_of(state, "room"), number_of(state, "sequence"),
           cJSON_IsTrue(list_of(state, "closed")) ? "  closed" : "");
    print_scene(state, now->revision);
    print_people(state);
    cJSON_ArrayForEach(item, list_of(state, "pins")) print_pin(item, false);
    cJSON_ArrayForEach(item, list_of(state, "decisions")) print_decision(item, now);
}

// ---- pictures

static int save_picture(struct room_call *c, uint64_t pin)
{
    struct options *o = c->options;
    fit_terminal(o);
    struct relight_room_view view = {.pin = pin,
                                     .decision = o->decision,
                                     .revision = o->revision,
                                     .width = o->picture.width,
                                     .height = o->picture.height};
    struct relight_image image;
    if (!picture_ending(o->output, &view.format)) return picture_usage(o, "");
    if (view.format != RELIGHT_IMAGE_PNG && view.format != RELIGHT_IMAGE_EXR &&
        view.format != RELIGHT_IMAGE_RGB8) // of a terminal
        return report_usage(o, "-o %s: a room's pictures are exact: .png or .exr", o->output);
    if (view.format == RELIGHT_IMAGE_PNG)
        view.format = RELIGHT_IMAGE_JPEG; // stands for PNG16, which was seen
    if (relight_room_picture(c->client, c->room, &view, &image, &c->error))
        return room_failed(c);
    int status = put_picture(o, &image);
    relight_image_finish(&image);
    return status;
}

int room_show(struct room_call *c)
{
    uint64_t pin = 0;
    if (c->n_word && (!whole_word(c->word[0], &pin) || !pin))
        return report_usage(c->options, "%s: expected a pin's number", c->word[0]);
    const bool decision = c->options->decision > 0, revision = c->options->revision > 0;
    if ((pin > 0) + decision + revision > 1)
        return report_usage(c->options, "show: one of PIN, --decision and --revision");
    if (c->options->output) return save_picture(c, pin);
    if (decision || revision)
        return report_usage(c->options,
                            "show: --decision and --revision are for a picture: -o FILE");
    cJSON *state = room_state(c);
    if (!state) return EXIT_FAILED;
    const cJSON *item = pin ? item_of(list_of(state, "pins"), (double)pin) : NULL;
    int status = EXIT_DONE;
    if (pin && !item) {
        c->error = (struct relight_error){.code = RELIGHT_E_NOT_FOUND};
        snprintf(c->error.text, sizeof c->error.text, "the room has no pin %s", c->word[0]);
        status = room_failed(c);
    } else if (c->options->json) {
        print_json(cJSON_Duplicate(pin ? item : state, 1));
    } else if (pin) {
        print_pin(item, true);
    } else {
        struct room_now now;
        room_now(c, state, &now);
        print_room(state, &now);
    }
    cJSON_Delete(state);
    return status;
}

// ---- the log

static void print_event(const cJSON *event)
{
    char when[32];
    const cJSON *stamp = list_of(event, "stamp"), *action = list_of(event, "action");
    const cJSON *what = action ? action->child : NULL;
    print_time(when, number_of(stamp, "time_us"));
    printf("%6.0f  %s  %s  %s", number_of(stamp, "sequence"), when,
           escape(author_of(stamp)).text, what ? what->string : "?");
    const char *text = text_of(what, "text");
    if (!*text) text = text_of(what, "name");
    if (!*text) text = text_of(what, "note");
    if (*text) printf("  %s", escape(text).text);
    putchar('\n');
}

static int print_events(struct room_call *c, const char *text)
{
    cJSON *all = cJSON_Parse(text);
    const cJSON *event;
    cJSON_ArrayForEach(event, list_of(all, "events"))
    {
        if (c->options->json) print_json(cJSON_Duplicate(event, 1));
        else print_event(event);
    }
    cJSON_Delete(all);
    fflush(stdout);
    return ferror(stdout) != 0;
}

int room_log(struct room_call *c)
{
    for (uint64_t after = 0, last;; after = last) {
        char *text;
        if (relight_room_log(c->client, c->room, after, &text, &last, &c->error))
            return room_failed(c);
        int stop = last ? print_events(c, text) : 1;
        free(text);
        if (stop) return ferror(stdout) ? EXIT_FAILED : EXIT_DONE;
    }
}

// `now` is filled before the watch begins: while it lasts the connection carries no other
// request.
struct watching {
    struct room_call *c;
    struct room_now now;
};

static int news(void *user, enum relight_room_news kind, const char *text)
{
    struct watching *w = user;
    struct room_call *c = w->c;
    if (kind == RELIGHT_ROOM_EVENTS) return print_events(c, text);
    cJSON *json = cJSON_Parse(text);
    const cJSON *p;
    if (c->options->json) {
        print_json(json);
        fflush(stdout);
        return ferror(stdout) != 0;
    }
    if (kind == RELIGHT_ROOM_STATE) {
        room_now_scene(json, &w->now);
        print_room(json, &w->now);
    }
    cJSON_ArrayForEach(p, list_of(json, "participants"))
    {
        if (cJSON_IsTrue(list_of(p, "gone")))
            printf("        participant %.0f left\n", number_of(p, "key"));
        else
            printf("        participant %.0f: %s  %s%s\n", number_of(p, "key"),
                   escape(author_of(p)).text, text_of(p, "role"),
                   cJSON_IsTrue(list_of(p, "alone")) ? "  looks around alone" : "");
    }
    cJSON_Delete(json);
    fflush(stdout);
    return ferror(stdout) != 0;
}

int room_watch(struct room_call *c)
{
    struct watching w = {.c = c};
    cJSON *state = room_state(c);
    if (!state) return EXIT_FAILED;
    room_now(c, state, &w.now);
    cJSON_Delete(state);
    if (relight_room_follow(c->client, c->room, c->me, NULL, -1, news, &w, &c->error))
        return room_failed(c);
    return EXIT_DONE;
}
