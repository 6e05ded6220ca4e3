prt_test(fair_queue SOURCES unit/fair_queue.c LIBS relightd_rooms LABELS unit)
