// Certificates for tests, minted by deploy/pki/mint into a temporary directory.
#ifndef RIPS_SERVICES_RPC_TEST_PKI_H_
#define RIPS_SERVICES_RPC_TEST_PKI_H_

#include <string>

#include "absl/strings/string_view.h"
#include "services/runtime/config_sections.h"

namespace rips::rpc {

// One certificate authority. Removes its directory at the end. A failure of the script ends the
// process: no test can go on without. One thread at a time.
class TestPki {
 public:
  explicit TestPki(absl::string_view trust_domain = "fleet.example");
  ~TestPki();
  TestPki(const TestPki&) = delete;
  TestPki& operator=(const TestPki&) = delete;

  TlsFiles Server(absl::string_view id = "ps1");
  TlsFiles Sensor(absl::string_view robot = "r1", absl::string_view host = "base");
  TlsFiles Actuator(absl::string_view robot = "r1", absl::string_view host = "base");
  // `role` is viewer, operator or admin.
  TlsFiles Operator(absl::string_view role = "admin", absl::string_view name = "alice");

  // A leaf the script would never mint: `san` as in openssl's subjectAltName, `URI:a,URI:b`, for
  // use as client and server. In `folder`, which must be new.
  struct Special {
    std::string folder;
    std::string san;
    bool by_root = false;  // signed by the root, whose names are not constrained
    int days = 1;          // 0 = expires at once
    int age_seconds = 0;   // since the start of its life; negative = not valid yet
  };
  TlsFiles Mint(const Special& special);
  // Replaces the server's pair by a new one of the same identity, as a renewal does.
  void RenewServer(absl::string_view id = "ps1");

  // Puts the leaf of `files` onto the revocation list, and returns the list's path. The list that
  // is there is replaced at once.
  std::string Revoke(const TlsFiles& files);
  // Signs the list as it is, good for so many days.
  std::string SignRevocations(int days = 30);

  const std::string& dir() const { return dir_; }

 private:
  TlsFiles RunScript(absl::string_view arguments, absl::string_view folder);
  TlsFiles FilesIn(absl::string_view folder) const;

  std::string trust_domain_;
  std::string dir_;
};

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_TEST_PKI_H_
