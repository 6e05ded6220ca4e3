prt_test(screen_frames SOURCES physics/screen_frames.c physics/screen_stage.c physics/bodies.c LIBS prt_screen prt_reference
  LABELS physics)
