// Counts what is allocated with `new` in this program.
#include <cstdlib>
#include <new>

#include "tests/bench/world.h"

namespace rips::bench {
namespace {

thread_local uint64_t allocations = 0;

void* Allocate(size_t bytes, size_t alignment) {
  ++allocations;
  void* memory = nullptr;
  if (alignment <= alignof(std::max_align_t)) {
    memory = std::malloc(bytes == 0 ? 1 : bytes);
  } else {
    memory = std::aligned_alloc(alignment, (bytes + alignment - 1) / alignment * alignment);
  }
  if (memory == nullptr) std::abort();
  return memory;
}

}  // namespace

uint64_t Allocations() { return allocations; }

}  // namespace rips::bench

// The other forms call these.
void* operator new(size_t bytes) { return rips::bench::Allocate(bytes, 0); }
void* operator new(size_t bytes, std::align_val_t alignment) {
  return rips::bench::Allocate(bytes, static_cast<size_t>(alignment));
}
void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, size_t) noexcept { std::free(memory); }
void operator delete(void* memory, std::align_val_t) noexcept { std::free(memory); }
void operator delete(void* memory, size_t, std::align_val_t) noexcept { std::free(memory); }
