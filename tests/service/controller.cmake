# relight-control with devices of umockdev. Beside the address sanitizer umockdev's preload library
# works where the sanitizer's comes before it; beside the thread sanitizer it finds no device.
set(control_preload libumockdev-preload.so.0)
if(PRT_SANITIZE MATCHES address AND CMAKE_C_COMPILER_ID STREQUAL GNU)
  execute_process(COMMAND ${CMAKE_C_COMPILER} -print-file-name=libasan.so OUTPUT_VARIABLE asan
    OUTPUT_STRIP_TRAILING_WHITESPACE)
  set(control_preload ${asan}:${control_preload})
elseif(PRT_SANITIZE)
  message(STATUS "controller is left out: umockdev does not work beside this sanitizer")
  return()
endif()
pkg_check_modules(CJSON REQUIRED IMPORTED_TARGET libcjson)
pkg_check_modules(UMOCKDEV REQUIRED IMPORTED_TARGET umockdev-1.0)
prt_test(controller SOURCES service/controller.c service/usb_mock.c
  LIBS librelight PkgConfig::UMOCKDEV PkgConfig::CJSON LABELS service)
target_include_directories(test_controller PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service)
target_compile_definitions(test_controller PRIVATE CONTROL_PRELOAD="${control_preload}")
add_dependencies(test_controller relightd prt_program relight-control)
