// SPDX-License-Identifier: MIT
// Colours on a slow link: where a client acknowledges late, frames of a state that moves have
// fewer vertices, which the client expands; the state that rests comes whole.
#include "ball.h"

enum { MOST_TURNS = 400, LATE_US = 215000, BYTES = 4 * N_VERTEX };
static char id[ID_SIZE];

static int setup(void **state)
{
    struct relight_loaded loaded;
    ball_setup(state);
    OK(load_ball("slow.obj", small_load(false), &loaded));
    if (loaded.job && *loaded.job) OK(relight_watch(client, loaded.job, NULL, NULL, &error));
    snprintf(id, sizeof id, "%s", loaded.model);
    relight_loaded_finish(&loaded);
    return 0;
}

static struct relight_light turned(int turn)
{
    struct relight_light light = *sun();
    light.rotate_deg = (float)(turn % 90);
    return light;
}

static void next(struct relight_view *view, struct relight_frame_out *frame)
{
    OK(relight_view_next(view, 60, frame, &error));
    assert_true(frame->has_colors);
}

static struct relight_view *open_colors(bool coarse)
{
    const struct relight_light light = turned(0);
    const struct relight_view_request request = {.model = id,
                                                 .n_light = 1,
                                                 .lights = &light,
                                                 .colors = true,
                                                 .color_format = RELIGHT_COLOR_RGB9E5,
                                                 .max_fps = 5, // no fewer rows to keep it
                                                 .window = 1,
                                                 .coarse = coarse};
    struct relight_view *view;
    struct relight_frame_out frame;
    OK(relight_view_open(client, &request, &view, &error));
    next(view, &frame);
    assert_int_equal(frame.colors.n_coarse, 0);
    relight_frame_out_finish(&frame);
    return view;
}

// Turns the light and takes its frame late. The link is slow because the client is.
static void turn_late(struct relight_view *view, int turn, struct relight_frame_out *frame)
{
    const struct relight_light light = turned(turn);
    OK(relight_view_set(view, 1, &light, NULL, NULL, NULL, &error));
    usleep(LATE_US);
    next(view, frame);
}

static void whole_colors(int turn, float *out, const void *bytes)
{
    const struct relight_light light = turned(turn);
    struct relight_colors_request request = {
        .model = id, .n_light = 1, .lights = &light, .format = RELIGHT_COLOR_RGB9E5};
    struct relight_colors colors;
    OK(relight_colors(client, &request, &colors, &error));
    OK(relight_colors_decode(&colors, 0, out));
    if (bytes) assert_memory_equal(colors.data, bytes, BYTES);
    relight_colors_finish(&colors);
}

// The colours that were sent are those of the whole answer, the others near them.
static void check_coarse(const struct relight_coarse_order *order,
                         const struct relight_colors *colors, int turn)
{
    static float all[3 * N_VERTEX], want[3 * N_VERTEX];
    double wrong = 0, power = 0;
    OK(relight_coarse_expand(order, colors, 0, all));
    whole_colors(turn, want, NULL);
    for (uint32_t i = 0; i < colors->n_coarse; i++) {
        const uint32_t v = order->vertex[i];
        assert_memory_equal(all + 3 * v, want + 3 * v, 12);
    }
    for (int i = 0; i < 3 * N_VERTEX; i++) {
        wrong += ((double)all[i] - (double)want[i]) * ((double)all[i] - (double)want[i]);
        power += (double)want[i] * (double)want[i];
    }
    print_message("%u of %d vertices: %.2f %%\n", colors->n_coarse, N_VERTEX,
                  100 * sqrt(wrong / power));
    assert_true(sqrt(wrong / power) < 0.1);
}

static void late_frames_are_coarse(void **state)
{
    struct relight_coarse_order order;
    struct relight_view *view = open_colors(true);
    struct relight_frame_out frame;
    uint32_t wanted = (N_VERTEX + 1) / 2, turn = 1;
    static float out[3 * N_VERTEX];
    OK(relight_coarse_order(client, id, &order, &error));
    assert_int_equal(order.n_vertex, N_VERTEX);
    for (uint32_t reduced = 2; reduced <= 8; reduced *= 2, wanted = (wanted + 1) / 2) {
        do { // each level holds for some frames
            turn_late(view, (int)turn++, &frame);
            const bool there = frame.colors.cost.reduced == reduced;
            if (there) {
                assert_true(frame.colors.n_coarse >= wanted &&
                            frame.colors.n_coarse <= wanted + 1);
                assert_true(frame.colors.coarse_order == order.hash);
                check_coarse(&order, &frame.colors, (int)turn - 1);
            }
            relight_frame_out_finish(&frame);
            if (there) break;
        } while (turn < MOST_TURNS);
        assert_true(turn < MOST_TURNS);
    }
    next(view, &frame); // the state rests
    assert_int_equal(frame.colors.n_coarse, 0);
    assert_int_equal(frame.colors.cost.reduced, 0);
    whole_colors((int)turn - 1, out, frame.colors.data);
    relight_frame_out_finish(&frame);
    OK(relight_view_close(view, NULL, NULL, &error));
    relight_coarse_order_finish(&order);
}

// A client that did not say that it can expand them gets whole frames on any link.
static void whole_frames_without_consent(void **state)
{
    struct relight_view *view = open_colors(false);
    for (int turn = 1; turn < 8; turn++) {
        struct relight_frame_out frame;
        turn_late(view, turn, &frame);
        assert_int_equal(frame.colors.n_coarse, 0);
        relight_frame_out_finish(&frame);
    }
    OK(relight_view_close(view, NULL, NULL, &error));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(late_frames_are_coarse),
        cmocka_unit_test(whole_frames_without_consent),
    };
    return cmocka_run_group_tests_name("slow_view", tests, setup, ball_teardown);
}
