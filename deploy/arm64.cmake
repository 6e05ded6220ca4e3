# Cross-builds for arm64 with Debian's compiler (crossbuild-essential-arm64) and libraries:
#   tests/arm64 makes the folder of libraries, configures, builds and runs the tests.
# PRT_SYSROOT is a folder that Debian's arm64 packages were unpacked into.
set(CMAKE_SYSTEM_NAME Linux)
set(CMAKE_SYSTEM_PROCESSOR aarch64)
set(CMAKE_C_COMPILER aarch64-linux-gnu-gcc)
set(CMAKE_CXX_COMPILER aarch64-linux-gnu-g++)
set(CMAKE_LIBRARY_ARCHITECTURE aarch64-linux-gnu)

set(PRT_SYSROOT "" CACHE PATH "folder with arm64 libraries and headers")
list(APPEND CMAKE_TRY_COMPILE_PLATFORM_VARIABLES PRT_SYSROOT)
set(CMAKE_SYSROOT ${PRT_SYSROOT})
set(CMAKE_FIND_ROOT_PATH_MODE_PROGRAM NEVER)
set(CMAKE_FIND_ROOT_PATH_MODE_LIBRARY ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_INCLUDE ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_PACKAGE ONLY)

set(libraries ${PRT_SYSROOT}/usr/lib/aarch64-linux-gnu)
set(ENV{PKG_CONFIG_SYSROOT_DIR} ${PRT_SYSROOT})
set(ENV{PKG_CONFIG_LIBDIR} ${libraries}/pkgconfig:${PRT_SYSROOT}/usr/share/pkgconfig)
# Libraries that libraries need are looked up here when a program is linked.
foreach(kind EXE SHARED MODULE)
  set(CMAKE_${kind}_LINKER_FLAGS_INIT
    "-Wl,-rpath-link,${libraries}:${PRT_SYSROOT}/lib/aarch64-linux-gnu")
endforeach()

# gcc 12.2 for arm64 stops with an internal error in loops with a conditional minimum (at -O3, in
# vect_transform_reduction); the kernels do not depend on loop vectorisation.
set(CMAKE_C_FLAGS_INIT -fno-tree-loop-vectorize)

# ctest runs the programs under qemu's user mode.
find_program(QEMU_AARCH64 NAMES qemu-aarch64 qemu-aarch64-static)
if(QEMU_AARCH64)
  set(CMAKE_CROSSCOMPILING_EMULATOR ${QEMU_AARCH64} -L ${PRT_SYSROOT})
endif()
