# relight-control with devices of umockdev, whose preload library does not work beside the address
# sanitizer's: the program finds no device. fuzz_hid covers what reads a device's bytes.
if(PRT_SANITIZE)
  return()
endif()
pkg_check_modules(CJSON REQUIRED IMPORTED_TARGET libcjson)
pkg_check_modules(UMOCKDEV REQUIRED IMPORTED_TARGET umockdev-1.0)
prt_test(controller SOURCES service/controller.c service/usb_mock.c
  LIBS librelight PkgConfig::UMOCKDEV PkgConfig::CJSON LABELS service TIMEOUT 300)
target_include_directories(test_controller PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service)
add_dependencies(test_controller relightd prt_program relight-control)
