prt_test(screen_texture SOURCES physics/screen_texture.c physics/screen_stage.c physics/bodies.c LIBS prt_screen prt_reference
  LABELS physics)
