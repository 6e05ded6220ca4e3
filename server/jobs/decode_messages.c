// SPDX-License-Identifier: MIT
// Packets between the daemon and its decode helper: sent and received whole, with at most one
// descriptor beside each.
#include "jobs/decode_messages.h"

#include <errno.h>
#include <string.h>
#include <sys/socket.h>

bool decode_send_packet(int socket_fd, const void *bytes, size_t n, int passed_fd)
{
    struct iovec iov = {(void *)bytes, n};
    union {
        struct cmsghdr head;
        char room[CMSG_SPACE(sizeof(int))];
    } control = {0};
    struct msghdr message = {.msg_iov = &iov, .msg_iovlen = 1};
    if (passed_fd >= 0) {
        message.msg_control = &control;
        message.msg_controllen = sizeof control.room;
        control.head = (struct cmsghdr){.cmsg_len = CMSG_LEN(sizeof(int)),
                                        .cmsg_level = SOL_SOCKET,
                                        .cmsg_type = SCM_RIGHTS};
        memcpy(CMSG_DATA(&control.head), &passed_fd, sizeof passed_fd);
    }
    ssize_t sent;
    while ((sent = sendmsg(socket_fd, &message, MSG_NOSIGNAL)) < 0 && errno == EINTR) continue;
    return sent >= 0;
}

ssize_t decode_receive_packet(int socket_fd, void *bytes, size_t n, int *passed_fd)
{
    struct iovec iov = {bytes, n};
    union {
        struct cmsghdr head;
        char room[CMSG_SPACE(sizeof(int))];
    } control;
    struct msghdr message = {.msg_iov = &iov,
                             .msg_iovlen = 1,
                             .msg_control = &control,
                             .msg_controllen = sizeof control.room};
    *passed_fd = -1;
    ssize_t got = recvmsg(socket_fd, &message, MSG_DONTWAIT | MSG_CMSG_CLOEXEC);
    struct cmsghdr *head = got > 0 ? CMSG_FIRSTHDR(&message) : NULL;
    if (head && head->cmsg_type == SCM_RIGHTS)
        memcpy(passed_fd, CMSG_DATA(head), sizeof *passed_fd);
    return got;
}

size_t decode_pixel_bytes(uint32_t kind, uint32_t width, uint32_t height, uint32_t cube_n)
{
    return kind == PRT_ENV_CUBE ? (size_t)6 * cube_n * cube_n * 12
                                : (size_t)width * height * 12;
}
