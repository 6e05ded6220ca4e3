// SPDX-License-Identifier: MIT
// What rooms and their guests may take of the daemon.
#include "room_frames.h"

#include "lone_daemon.h"

static void make_guest(struct frames *owner, const char *room, char secret[64])
{
    Relight__Invite m = RELIGHT__INVITE__INIT;
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    m.role = RELIGHT__ROOM_ROLE__ROLE_VIEWER;
    m.name = "guest";
    action.invite = &m;
    room_add_edit(owner, 6, room, &action, "Ann", "", 0);
    frames_send(owner);
    struct reply r = reply_to(owner, 6);
    if (r.code) fail_msg("invite: %s", r.text);
    snprintf(secret, 64, "%s", ((Relight__RoomEditAnswer *)r.message)->secret);
    reply_free(&r);
}

// Guests take what their inviter may take, also after a restart: many invitations are one
// client. The log names each.
static void guests_share_their_inviters_limits(void **unused)
{
    enum { MOST = 4, GUESTS = 6 };
    static const char *const extra[] = {"--client-connections", "4", NULL};
    char room[33], ann[RELIGHT_SECRET], secret[GUESTS][64];
    begin(extra);
    make_token(&d, "ann", 2, ann);
    struct frames *owner = frames_token(&d, ann, NULL), *guest[GUESTS];
    room_create(owner, "guests", room);
    for (int i = 0; i < GUESTS; i++) make_guest(owner, room, secret[i]);
    for (int start = 0; start < 2; start++) {
        for (int i = 0, code; i < GUESTS; i++) {
            guest[i] = frames_token(&d, secret[i], &code);
            assert_int_equal(code, i + 1 < MOST ? 0 : RELIGHT__ERROR_CODE__ERROR_BUSY);
            if (code) assert_non_null(strstr(token_text, "--client-connections"));
        }
        for (int i = 0; i < GUESTS; i++) frames_close(guest[i]);
        frames_close(owner);
        assert_true(log_says(&d, " who=guest:", 5000));
        assert_int_equal(daemon_stop(&d), 0);
        daemon_start(&d, extra);
        owner = frames_token(&d, ann, NULL);
    }
    frames_close(owner);
    end();
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_teardown(guests_share_their_inviters_limits, teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
