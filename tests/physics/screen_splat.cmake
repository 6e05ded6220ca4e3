prt_test(screen_splat SOURCES physics/screen_splat.c physics/screen_stage.c physics/bodies.c LIBS prt_screen prt_reference
  LABELS physics)
