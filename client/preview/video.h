/* SPDX-License-Identifier: MIT */
/* video.h owns films: frames go to the program ffmpeg, which writes the file. */
#ifndef RELIGHT_PREVIEW_VIDEO_H
#define RELIGHT_PREVIEW_VIDEO_H

#include <stdbool.h>
#include <stdint.h>

/* Whether the path ends in .mp4 or .webm. */
bool video_is_name(const char *path);

struct video;
/* Starts ffmpeg for pictures of this size. NULL with a message where there is none, or where an
 * .mp4 has an odd side. */
struct video *video_open(const char *path, uint32_t width, uint32_t height, double fps);
/* rgb: [height][width][3], sRGB. False where ffmpeg takes no more; video_close says so. */
bool video_add(struct video *video, const uint8_t *rgb);
/* Waits for ffmpeg. An exit status. */
int video_close(struct video *video);

#endif
