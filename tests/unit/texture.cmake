prt_test(texture SOURCES unit/texture.c LIBS prt_mesh prt_texture prt_light LABELS unit)
