prt_test(render SOURCES unit/render.c LIBS relightd_rooms LABELS unit)
