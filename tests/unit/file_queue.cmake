prt_test(file_queue SOURCES unit/file_queue.c LIBS relightd_rooms LABELS unit)
