// SPDX-License-Identifier: MIT
// A person in a room for follow.sh: says the Participant of each line of its standard input,
// and sits there until that ends.
//   room_hand ADDRESS ROOM
#include "relight/relight.h"

#include <pthread.h>
#include <semaphore.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static struct relight_client *client;
static const char *room;
static sem_t seated;

static int take_news(void *user, enum relight_room_news news, const char *json)
{
    (void)user, (void)json;
    if (news == RELIGHT_ROOM_STATE) sem_post(&seated);
    return 0;
}

static void *sit(void *user)
{
    struct relight_error error;
    (void)user;
    if (relight_room_follow(client, room, "Hand", NULL, -1, take_news, NULL, &error))
        fprintf(stderr, "%s\n", error.text), exit(1);
    return NULL;
}

int main(int argc, char **argv)
{
    char line[1000];
    pthread_t thread;
    struct relight_error error;
    if (argc != 3) return 2;
    room = argv[2];
    sem_init(&seated, 0, 0);
    if (relight_connect(argv[1], NULL, &client, &error) ||
        pthread_create(&thread, NULL, sit, NULL))
        return 1;
    sem_wait(&seated);
    while (fgets(line, sizeof line, stdin)) {
        line[strcspn(line, "\n")] = 0;
        if (!relight_room_present(client, room, line, &error)) continue;
        fprintf(stderr, "%s\n", error.text);
        exit(1);
    }
    exit(0); // the thread has the connection
}
