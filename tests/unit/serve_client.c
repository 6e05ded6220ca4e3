// SPDX-License-Identifier: MIT
// The clients of `prt-bench serve`: a request that the socket takes in parts arrives whole.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cmocka.h>

#include "bench.h"
#include "serve_client.h"

static void a_request_in_parts(void **state)
{
    enum { SIZE = 3 << 20, PIECE = 50000 };
    static uint8_t sent[SIZE], got[SIZE + PIECE];
    static struct serve_client c;
    struct bench_env env = {0};
    struct serve_crowd crowd = {.env = &env, .client = &c, .n = 1};
    int pair[2];
    size_t n = 0;
    for (size_t i = 0; i < SIZE; i++) sent[i] = (uint8_t)(i * 2654435761u >> 24);
    assert_int_equal(socketpair(AF_UNIX, SOCK_STREAM, 0, pair), 0);
    crowd.epoll_fd = epoll_create1(EPOLL_CLOEXEC);
    c = (struct serve_client){.crowd = &crowd, .fd = pair[0]};
    struct relight_frame_limits limits = {1 << 16, 1 << 16};
    relight_decoder_init(&c.decoder, &limits);
    struct epoll_event e = {.events = EPOLLIN, .data.ptr = &c};
    assert_int_equal(epoll_ctl(crowd.epoll_fd, EPOLL_CTL_ADD, c.fd, &e), 0);
    assert_int_equal(serve_send(&c, RELIGHT_TYPE_PING, NULL, sent, SIZE, 0), 1);
    for (ssize_t part = 1; part > 0;) {
        serve_turn(&crowd, 0);
        part = recv(pair[1], got + n, PIECE, MSG_DONTWAIT);
        n += part > 0 ? (size_t)part : 0;
        assert_in_range(n, 0, SIZE + 1000);
    }
    assert_true(n > SIZE);
    assert_memory_equal(got + n - SIZE, sent, SIZE);
    assert_int_equal(c.out_sent, c.out_size);
    close(crowd.epoll_fd);
    close(pair[0]);
    close(pair[1]);
    relight_decoder_finish(&c.decoder);
    free(c.out);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(a_request_in_parts)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
