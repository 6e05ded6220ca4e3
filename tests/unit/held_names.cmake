prt_test(held_names SOURCES unit/held_names.c LIBS relightd_rooms LABELS unit)
