# relight-control without devices.
prt_test(hid SOURCES unit/hid.c ${CMAKE_SOURCE_DIR}/client/controller/scene_change.c
  ${CMAKE_SOURCE_DIR}/client/controller/motion.c LIBS relight_hid relight_program librelight LABELS unit)
target_include_directories(test_hid PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service)
