// SPDX-License-Identifier: MIT
#include "answers.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "relight.pb-c.h"

void answers_init(struct answers *a)
{
    static const struct relight_frame_limits limits = {16 << 20, 1ull << 32, false};
    relight_decoder_init(&a->decoder, &limits);
    a->exact = true;
}

void answers_finish(struct answers *a)
{
    relight_decoder_finish(&a->decoder);
}

void answers_ask(struct answers *a, uint64_t id, uint16_t type)
{
    if (id >= ANSWERS_IDS) return;
    a->type[id] = a->asked[id] && a->type[id] != type ? 0xffff : type;
    a->asked[id]++;
}

static const char *fault(const struct relight_frame *f, const char *what)
{
    static char text[200];
    snprintf(text, sizeof text, "an answer of type %s, id %llu: %s", relight_type_name(f->type),
             (unsigned long long)f->id, what);
    return text;
}

static const char *check_id(struct answers *a, const struct relight_frame *f)
{
    if (!a->exact) return NULL;
    // Payloads are refused with their frame until HELLO was answered.
    if (!a->greeted && !f->id && f->type == RELIGHT_TYPE_ERROR) return NULL;
    if (f->id >= ANSWERS_IDS || !a->asked[f->id])
        return fault(f, "nothing was asked under this id");
    if (f->type != RELIGHT_TYPE_ERROR && a->type[f->id] != 0xffff &&
        f->type != (a->type[f->id] | RELIGHT_TYPE_ANSWER))
        return fault(f, "the request was of another type");
    if (a->ended[f->id] >= a->asked[f->id]) return fault(f, "its last answer came before");
    if (f->flags & RELIGHT_FRAME_LAST) a->ended[f->id]++;
    a->greeted |= f->type == (RELIGHT_TYPE_HELLO | RELIGHT_TYPE_ANSWER);
    return NULL;
}

static const char *check_message(struct world *world, const struct relight_frame *f,
                                 const ProtobufCMessage *message)
{
    if (f->type == RELIGHT_TYPE_ERROR) {
        const Relight__Error *error = (const Relight__Error *)message;
        if (!error->code || error->code > RELIGHT__ERROR_CODE__ERROR_MOVED)
            return fault(f, "its code is none of the protocol's");
        if (!error->text[0]) return fault(f, "it says nothing");
    }
    if (f->type == (RELIGHT_TYPE_LOAD | RELIGHT_TYPE_ANSWER)) {
        const Relight__LoadAnswer *load = (const Relight__LoadAnswer *)message;
        world_learn_model(world, load->model);
        if (load->job[0]) world_learn_job(world, load->job);
    }
    if (f->type == (RELIGHT_TYPE_PUT_POSE | RELIGHT_TYPE_ANSWER))
        world_learn_pose(world, ((const Relight__PutPoseAnswer *)message)->pose);
    if (f->type == (RELIGHT_TYPE_ROOM_CREATE | RELIGHT_TYPE_ANSWER))
        world_learn_room(world, ((const Relight__RoomCreateAnswer *)message)->room);
    if (f->type == (RELIGHT_TYPE_CANCEL_JOB | RELIGHT_TYPE_ANSWER) &&
        ((const Relight__CancelJobAnswer *)message)->state > 5u)
        return fault(f, "the job's state is none of the protocol's");
    return NULL;
}

static const char *take_frame(struct answers *a, struct world *world,
                              const struct relight_frame *f)
{
    if (a->more && (f->id != a->more || f->type != a->more_type))
        return fault(f, "another message's payload was to go on");
    bool first = !a->more;
    a->more = f->flags & RELIGHT_FRAME_MORE ? f->id : 0;
    a->more_type = f->type;
    const char *wrong = check_id(a, f);
    if (wrong || !first) return wrong;
    // Every string of every answer is UTF-8.
    struct relight_header_cost cost;
    char error[RELIGHT_HEADER_ERROR];
    static const uint8_t empty[1];
    if (!relight_header_check(f->type, f->header ? f->header : empty, f->header_size, NULL,
                              &cost, error))
        return fault(f, error);
    ProtobufCMessage *message = relight_frame_unpack(f);
    if (!message) return fault(f, "its header does not parse");
    wrong = check_message(world, f, message);
    protobuf_c_message_free_unpacked(message, NULL);
    return wrong;
}

const char *answers_take(struct answers *a, struct world *world, const uint8_t *bytes, size_t n)
{
    for (size_t used; n; bytes += used, n -= used) {
        int status = relight_decoder_feed(&a->decoder, bytes, n, &used);
        if (status < 0) return relight_frame_fault_text(status);
        if (!status) continue;
        const char *wrong = take_frame(a, world, &a->decoder.frame);
        free(relight_decoder_take(&a->decoder));
        if (wrong) return wrong;
    }
    return NULL;
}
