// Writes a guarded variable without its mutex. The test `thread_safety` compiles this file with the
// warnings of every target, and passes if clang refuses it.
#include "services/runtime/mutex.h"

namespace rips {

class Counter {
 public:
  void Increment() { ++count_; }

 private:
  Mutex mu_;
  int count_ ABSL_GUARDED_BY(mu_) = 0;
};

void IncrementWithoutLock(Counter& counter) { counter.Increment(); }

}  // namespace rips
