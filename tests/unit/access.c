// SPDX-License-Identifier: MIT
// The delay after wrong tokens, scopes as words, tokens as text, and invitations.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include <cmocka.h>

#include "core/access.h"
#include "core/guesses.h"
#include "core/loop.h"
#include "core/options.h"
#include "core/token_store.h"
#include "rooms/guests.h"

static const uint64_t second = 1000000000;
static struct guesses guesses;

static void guess(const char *who, int n, uint64_t now)
{
    static unsigned number;
    char secret[32];
    for (int i = 0; i < n; i++) {
        snprintf(secret, sizeof secret, "guess-%u", number++);
        guesses_count(&guesses, who, secret, now);
    }
}

// One second after the fifth, doubled up to a minute, forgotten after ten minutes.
static void test_delays_double(void **state)
{
    uint64_t now = 1000 * second;
    guesses_init(&guesses);
    guess("addr:192.0.2.1", GUESSES_FREE - 1, now);
    assert_int_equal(guesses_wait_ms(&guesses, "addr:192.0.2.1", now), 0);
    for (unsigned wait_s = 1; wait_s < 100; wait_s *= 2) {
        unsigned expected = wait_s < 60 ? wait_s : 60;
        guess("addr:192.0.2.1", 1, now);
        assert_int_equal(guesses_wait_ms(&guesses, "addr:192.0.2.1", now), expected * 1000);
        now += expected * second;
        assert_int_equal(guesses_wait_ms(&guesses, "addr:192.0.2.1", now), 0);
    }
    assert_int_equal(guesses_wait_ms(&guesses, "addr:192.0.2.2", now), 0);
    for (int i = 0; i < 100; i++) guesses_count(&guesses, "addr:192.0.2.2", "revoked", now);
    assert_int_equal(guesses_wait_ms(&guesses, "addr:192.0.2.2", now), 0);
    now += 600 * second;
    guess("addr:192.0.2.1", 1, now);
    assert_int_equal(guesses_wait_ms(&guesses, "addr:192.0.2.1", now), 0);
}

// One customer's /64 counts as one address, the next /64 does not.
static void test_addresses(void **state)
{
    uint64_t now = 1000 * second;
    char who[64];
    guesses_init(&guesses);
    for (int i = 0; i < GUESSES_FREE; i++) {
        snprintf(who, sizeof who, "addr:2001:db8:0:1::%d", i + 1);
        guess(who, 1, now);
    }
    assert_int_equal(guesses_wait_ms(&guesses, "addr:2001:db8:0:1:ffff::", now), 1000);
    assert_int_equal(guesses_wait_ms(&guesses, "addr:2001:db8:0:2::1", now), 0);
    assert_int_equal(guesses_wait_ms(&guesses, "uid:1000", now), 0);
}

// A million addresses take no more memory, and a busy guesser among few others stays known.
static void test_bounded(void **state)
{
    uint64_t now = 1000 * second;
    char who[64];
    guesses_init(&guesses);
    for (int i = 0; i < 1000000; i++) {
        snprintf(who, sizeof who, "addr:10.%d.%d.%d", i >> 16, i >> 8 & 255, i & 255);
        guess(who, 1, now + (uint64_t)i);
    }
    guess("addr:192.0.2.1", GUESSES_FREE, now + second);
    for (int i = 0; i < 1000; i++) {
        snprintf(who, sizeof who, "addr:10.200.%d.%d", i >> 8, i & 255);
        guess(who, 1, now + second);
    }
    assert_int_equal(guesses_wait_ms(&guesses, "addr:192.0.2.1", now + second), 1000);
}

static void test_scopes(void **state)
{
    unsigned scopes = 99;
    char text[64];
    assert_true(scopes_parse(" view, admin ", &scopes));
    assert_int_equal(scopes, SCOPE_VIEW | SCOPE_ADMIN);
    scopes_print(scopes, text);
    assert_string_equal(text, "view,admin");
    assert_true(scopes_parse("", &scopes));
    assert_int_equal(scopes, 0);
    scopes_print(0, text);
    assert_string_equal(text, "none");
    static const char *const bad[] = {"views", "vie", "view;edit", "all", "*"};
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++)
        assert_false(scopes_parse(bad[i], &scopes));
}

// Who comes without a token, on which carrier.
static void test_without_tokens(void **state)
{
    struct options options = {.local_scopes = "view"};
    struct access *access;
    struct caller caller;
    char fault[256], own[32];
    uint32_t retry_ms;
    snprintf(own, sizeof own, "uid:%u", (unsigned)geteuid());
    assert_int_equal(access_create(&options, NULL, &access, fault), 0);
    const struct {
        const char *who;
        unsigned open, closed; // scopes before and after there is a token
    } rows[] = {
        {own, SCOPE_ALL, SCOPE_ALL},
        {"uid:0", SCOPE_ALL, SCOPE_ALL},
        {"uid:54321", SCOPE_VIEW, SCOPE_VIEW},
        {"addr:127.0.0.1", SCOPE_ALL, 0},
        {"addr:127.9.9.9", SCOPE_ALL, 0},
        {"addr:::1", SCOPE_ALL, 0},
        {"addr:::ffff:127.0.0.1", SCOPE_ALL, 0},
        {"addr:192.0.2.7", SCOPE_ALL & ~SCOPE_ADMIN, 0}, // --accept-anyone
        {"addr:2001:db8::1", SCOPE_ALL & ~SCOPE_ADMIN, 0},
        {"addr:127.0.0.1.example", SCOPE_ALL & ~SCOPE_ADMIN, 0},
        {"unknown", SCOPE_ALL & ~SCOPE_ADMIN, 0},
    };
    for (int required = 0; required < 2; required++) {
        access_set_default(access, required ? "sesame" : "");
        assert_int_equal(access_required(access), required);
        for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
            unsigned expected = required ? rows[i].closed : rows[i].open;
            int verdict = access_check(access, rows[i].who, "", &caller, fault, &retry_ms);
            assert_int_equal(verdict, expected ? ACCESS_GRANTED : ACCESS_NO_TOKEN);
            if (expected) assert_int_equal(caller.scopes, expected);
            if (expected) assert_string_equal(caller.name, rows[i].who);
        }
    }
    assert_int_equal(access_check(access, own, "sesam", &caller, fault, &retry_ms),
                     ACCESS_WRONG); // it is not taken for none
    assert_int_equal(
        access_check(access, "addr:192.0.2.7", "sesame", &caller, fault, &retry_ms),
        ACCESS_GRANTED);
    assert_string_equal(caller.name, "token:default");
    access_destroy(access);
}

// Requests that may be sent at once: as many as a second has, and of a slow rate ACCESS_BURST;
// however long the token rested.
static void test_rate(void **state)
{
    static const double rate[] = {0.5, 4, 40};
    const struct options options = {.local_scopes = "view"};
    for (int i = 0; i < 3; i++) {
        const unsigned most = rate[i] > ACCESS_BURST ? (unsigned)rate[i] : ACCESS_BURST;
        struct access *access;
        struct caller caller = {.name = "token:slow"}, other = {.name = "uid:1"};
        char text[256], hash[65], fault[256];
        uint32_t retry_ms = 0;
        memset(hash, 'a', 64);
        hash[64] = 0;
        snprintf(text, sizeof text,
                 "{\"tokens\": [{\"name\": \"slow\", \"hash\": \"%s\", \"scopes\": \"view\", "
                 "\"created\": 1, \"by\": \"x\", \"quotas\": {\"rate\": %g}}]}",
                 hash, rate[i]);
        assert_int_equal(access_create(&options, NULL, &access, fault), 0);
        assert_int_equal(access_replace(access, text, strlen(text), fault), 0);
        struct token *token = &access_store(access)->token[0];
        for (int rest = 0; rest < 3; rest++) { // none, an hour, a fifth of a second
            const unsigned more = (unsigned)(rate[i] / 5);
            const uint64_t start = loop_now_ns();
            unsigned n = 0;
            while (n < 1000 && access_take_request(access, &caller, &retry_ms)) n++;
            // Requests that the time of taking them has added, and one of rounding.
            const unsigned slack =
                1 + (unsigned)(rate[i] * (double)(loop_now_ns() - start) / 1e9);
            if (rest < 2) assert_in_range(n, most, most + slack);
            else assert_in_range(n, more, more + slack);
            assert_in_range(retry_ms, 1, (unsigned)(1e3 / rate[i]) + 1);
            token->allowance_ns -= rest ? second / 5 : 3600 * second;
        }
        for (int k = 0; k < 100; k++)
            assert_true(access_take_request(access, &other, &retry_ms));
        // A new list of tokens does not refill the allowance of a token that stays in it.
        while (access_take_request(access, &caller, &retry_ms)) continue;
        const uint64_t start = loop_now_ns();
        assert_int_equal(access_replace(access, text, strlen(text), fault), 0);
        unsigned n = 0;
        while (n < 1000 && access_take_request(access, &caller, &retry_ms)) n++;
        assert_in_range(n, 0, 1 + (unsigned)(rate[i] * (double)(loop_now_ns() - start) / 1e9));
        access_destroy(access);
    }
}

// Tokens that are written and read again, by a restart or another replica, are the same.
static void test_tokens_as_text(void **state)
{
    struct token_store store = {0}, again;
    struct token first = {.name = "first",
                          .scopes = SCOPE_VIEW | SCOPE_UPLOAD,
                          .created_s = 1700000001,
                          .expires_s = 1900000002,
                          .by = "uid:1000",
                          .rate = 2.5},
                 plain = {
                     .name = "plain", .scopes = SCOPE_ADMIN, .created_s = 5, .by = "uid:0"};
    char fault[256] = "";
    memset(first.hash, 0xa5, sizeof first.hash);
    memset(plain.hash, 0x5a, sizeof plain.hash);
    for (size_t i = 0; i < n_token_quota; i++) first.limit[token_quotas[i].resource] = 1000 + i;
    assert_non_null(token_add(&store, &first, fault));
    assert_non_null(token_add(&store, &plain, fault));
    char *text = tokens_print(&store);
    assert_non_null(text);
    if (tokens_parse(text, strlen(text), &again, fault)) fail_msg("%s", fault);
    assert_int_equal(again.n, 2);
    for (size_t i = 0; i < 2; i++) {
        const struct token *a = &store.token[i], *b = &again.token[i];
        assert_string_equal(b->name, a->name);
        assert_string_equal(b->by, a->by);
        assert_memory_equal(b->hash, a->hash, sizeof a->hash);
        assert_int_equal(b->scopes, a->scopes);
        assert_int_equal(b->created_s, a->created_s);
        assert_int_equal(b->expires_s, a->expires_s);
        assert_true(b->rate == a->rate);
        assert_memory_equal(b->limit, a->limit, sizeof a->limit);
    }
    // Removing a token keeps the order of the others.
    token_remove(&again, &again.token[0]);
    assert_int_equal(again.n, 1);
    assert_string_equal(again.token[0].name, "plain");
    assert_null(token_find(&again, "first"));
    free(text);
    tokens_finish(&again);
    tokens_finish(&store);
}

// A store holds TOKENS_MAX tokens; one that is removed makes room for another.
static void test_most_tokens(void **state)
{
    struct token_store store = {0};
    struct token token = {.scopes = SCOPE_VIEW};
    char fault[256] = "";
    for (int i = 0; i < TOKENS_MAX; i++) {
        snprintf(token.name, sizeof token.name, "t%d", i);
        assert_non_null(token_add(&store, &token, fault));
    }
    for (int i = 0; i < 2; i++) {
        strcpy(token.name, "more");
        assert_null(token_add(&store, &token, fault));
        assert_non_null(strstr(fault, "1000 tokens"));
        token_remove(&store, token_find(&store, i ? "t999" : "t500"));
        snprintf(token.name, sizeof token.name, "again%d", i);
        assert_non_null(token_add(&store, &token, fault));
    }
    assert_int_equal(store.n, TOKENS_MAX);
    assert_null(token_find(&store, "t500"));
    assert_non_null(token_find(&store, "t998"));
    tokens_finish(&store);
}

// A token whose answer is on its way is not valid yet, whatever list is read meanwhile.
static void test_pending_token(void **state)
{
    const struct options options = {.local_scopes = "view"};
    static const char secret[] = "relight_secret";
    struct access *access;
    struct caller caller;
    struct token token = {
        .name = "new", .scopes = SCOPE_VIEW, .created_s = 1, .by = "x", .pending = true};
    char fault[256];
    uint32_t retry_ms;
    assert_int_equal(access_create(&options, NULL, &access, fault), 0);
    access_set_default(access, "sesame");
    token_hash(secret, token.hash);
    assert_non_null(token_add(access_store(access), &token, fault));
    for (int read = 0; read < 2; read++) {
        assert_int_equal(
            access_check(access, "addr:192.0.2.7", secret, &caller, fault, &retry_ms),
            ACCESS_WRONG);
        char *text = tokens_print(access_store(access));
        assert_int_equal(access_replace(access, text, strlen(text), fault), 0);
        free(text);
    }
    access_commit(access, token_find(access_store(access), "new"));
    assert_int_equal(access_check(access, "addr:192.0.2.7", secret, &caller, fault, &retry_ms),
                     ACCESS_GRANTED);
    access_destroy(access);
}

// Who came with a token is not who comes with another of its name: one that a replica made
// after it had revoked the first, or that --token-file has now.
static void test_token_made_anew(void **state)
{
    const struct options options = {.local_scopes = "view"};
    static const char *const word[2] = {"relight_first", "relight_second"};
    struct access *access;
    struct caller caller[2], shared[2];
    char fault[256];
    uint32_t retry_ms;
    assert_int_equal(access_create(&options, NULL, &access, fault), 0);
    for (int i = 0; i < 2; i++) {
        struct token_store list = {0};
        struct token token = {.name = "ann", .scopes = SCOPE_VIEW, .created_s = 1, .by = "x"};
        token_hash(word[i], token.hash);
        assert_non_null(token_add(&list, &token, fault));
        char *text = tokens_print(&list);
        assert_int_equal(access_replace(access, text, strlen(text), fault), 0);
        free(text);
        tokens_finish(&list);
        access_set_default(access, i ? "sesame" : "barley");
        assert_int_equal(access_check(access, "uid:7", word[i], &caller[i], fault, &retry_ms),
                         ACCESS_GRANTED);
        assert_int_equal(access_check(access, "uid:7", i ? "sesame" : "barley", &shared[i],
                                      fault, &retry_ms),
                         ACCESS_GRANTED);
        for (int k = 0; k <= i; k++) {
            assert_int_equal(access_is_current(access, &caller[k]), k == i);
            assert_int_equal(access_is_current(access, &shared[k]), k == i);
        }
    }
    // The daemon acts for the owner of a model, whatever token that has.
    const struct caller owner = {.name = "token:ann", .scopes = SCOPE_VIEW};
    assert_true(access_is_current(access, &owner));
    access_destroy(access);
}

static unsigned n_looked_at;

static enum access_verdict look_at_guest(void *user, const char *secret, struct caller *out,
                                         char error[256])
{
    n_looked_at++;
    return guests_check(user, secret, out, error);
}

static struct room_invite new_invite(uint64_t expires_s, char secret[GUEST_SECRET])
{
    struct room_invite invite = {.role = 1, .expires_s = expires_s};
    char id[GUEST_ID + 1];
    guest_generate(id, secret, invite.hash);
    strcpy(invite.id, id);
    return invite;
}

// Wrong invitations are guesses: no other is looked at before the delay is over.
static void test_guessed_invitations(void **state)
{
    const struct options options = {.local_scopes = "view"};
    struct guests guests = {0};
    struct access *access;
    struct caller caller;
    char fault[256], secret[GUEST_SECRET], wrong[GUEST_SECRET];
    uint32_t retry_ms;
    assert_int_equal(access_create(&options, NULL, &access, fault), 0);
    access_set_default(access, "sesame");
    access_set_guests(access, look_at_guest, guests_current, &guests);
    struct room_invite invite = new_invite(0, secret);
    assert_true(guests_add(&guests, "room", &invite));
    n_looked_at = 0;
    uint64_t last_ns = 0;
    for (unsigned i = 0; i < GUESSES_FREE; i++) {
        new_invite(0, wrong);
        last_ns = loop_now_ns();
        assert_int_equal(
            access_check(access, "addr:192.0.2.7", wrong, &caller, fault, &retry_ms),
            ACCESS_WRONG);
        assert_int_equal(n_looked_at, i + 1);
    }
    int verdict = access_check(access, "addr:192.0.2.7", secret, &caller, fault, &retry_ms);
    if (loop_now_ns() - last_ns >= second) skip(); // the machine stood still
    assert_int_equal(verdict, ACCESS_LATER);
    assert_in_range(retry_ms, 1, 1000);
    assert_int_equal(n_looked_at, GUESSES_FREE);
    assert_int_equal(access_check(access, "addr:192.0.2.8", secret, &caller, fault, &retry_ms),
                     ACCESS_GRANTED); // from elsewhere
    assert_int_equal(caller.scopes, SCOPE_VIEW);
    access_destroy(access);
    guests_finish(&guests);
}

// Each invitation of a room goes alone, whichever it is, and those of other rooms stay.
static void test_revoked_invitations(void **state)
{
    enum { N = 4 };
    char secret[N][GUEST_SECRET], other[GUEST_SECRET], fault[256];
    struct room_invite invite[N], elsewhere = new_invite(0, other);
    struct caller caller;
    for (int i = 0; i < N; i++) invite[i] = new_invite(0, secret[i]);
    for (int gone = 0; gone < N; gone++) {
        struct guests guests = {0};
        struct room_invite left[N];
        size_t n = 0;
        assert_true(guests_replace(&guests, "room", invite, N));
        assert_true(guests_replace(&guests, "other", &elsewhere, 1));
        for (int i = 0; i < N; i++)
            if (i != gone) left[n++] = invite[i];
        assert_true(guests_replace(&guests, "room", left, n));
        assert_int_equal(guests.n, N);
        for (int i = 0; i < N; i++)
            assert_int_equal(guests_check(&guests, secret[i], &caller, fault),
                             i == gone ? ACCESS_WRONG : ACCESS_GRANTED);
        assert_int_equal(guests_check(&guests, other, &caller, fault), ACCESS_GRANTED);
        assert_string_equal(guests_room(&guests, caller.name), "other");
        assert_true(guests_replace(&guests, "room", NULL, 0));
        assert_int_equal(guests.n, 1);
        assert_true(guests_current(&guests, caller.name));
        guests_finish(&guests);
    }
}

// An invitation expires at its time, also for a guest who is in the room already.
static void test_expired_invitations(void **state)
{
    struct guests guests = {0};
    struct caller caller;
    char secret[2][GUEST_SECRET], fault[256], principal[64];
    for (int i = 0; i < 2; i++) {
        struct room_invite invite =
            new_invite((uint64_t)time(NULL) + (i ? 1000 : 0), secret[i]);
        assert_true(guests_add(&guests, "room", &invite));
        int verdict = guests_check(&guests, secret[i], &caller, fault);
        assert_int_equal(verdict, i ? ACCESS_GRANTED : ACCESS_EXPIRED);
        if (i) assert_int_equal(caller.expires_s, (int64_t)invite.expires_s);
        snprintf(principal, sizeof principal, "guest:%s", invite.id);
        assert_int_equal(guests_current(&guests, principal), i);
    }
    guests_finish(&guests);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_delays_double),
        cmocka_unit_test(test_addresses),
        cmocka_unit_test(test_bounded),
        cmocka_unit_test(test_scopes),
        cmocka_unit_test(test_without_tokens),
        cmocka_unit_test(test_rate),
        cmocka_unit_test(test_tokens_as_text),
        cmocka_unit_test(test_pending_token),
        cmocka_unit_test(test_most_tokens),
        cmocka_unit_test(test_token_made_anew),
        cmocka_unit_test(test_guessed_invitations),
        cmocka_unit_test(test_revoked_invitations),
        cmocka_unit_test(test_expired_invitations),
    };
    return cmocka_run_group_tests_name("access_unit", tests, NULL, NULL);
}
