#include "services/rpc/test_pki.h"

#include <stdlib.h>

#include <cstdlib>

#include "absl/strings/str_cat.h"
#include "services/base/check.h"

namespace rips::rpc {
namespace {

void Run(const std::string& command) {
  RIPS_CHECK(std::system(command.c_str()) == 0, command.c_str());
}

}  // namespace

TestPki::TestPki(absl::string_view trust_domain) : trust_domain_(trust_domain) {
  char name[] = "/tmp/rips-pki-XXXXXX";
  RIPS_CHECK(mkdtemp(name) != nullptr, "mkdtemp");
  dir_ = name;
  RunScript("init", "ca");
}

TestPki::~TestPki() { Run(absl::StrCat("rm -rf ", dir_)); }

TlsFiles TestPki::FilesIn(absl::string_view folder) const {
  const std::string path = absl::StrCat(dir_, "/", folder);
  return {.ca = path + "/ca.pem", .cert = path + "/cert.pem", .key = path + "/key.pem"};
}

TlsFiles TestPki::RunScript(absl::string_view arguments, absl::string_view folder) {
  Run(absl::StrCat(RIPS_MINT, " --dir ", dir_, " --trust-domain ", trust_domain_, " ", arguments,
                   " >/dev/null"));
  return FilesIn(folder);
}

TlsFiles TestPki::Server(absl::string_view id) {
  const std::string arguments = absl::StrCat("server ", id);
  return RunScript(arguments, absl::StrCat("server/", id));
}

TlsFiles TestPki::Sensor(absl::string_view robot, absl::string_view host) {
  return RunScript(absl::StrCat("sensor ", robot, " ", host),
                   absl::StrCat("sensor/", robot, "/", host));
}

TlsFiles TestPki::Actuator(absl::string_view robot, absl::string_view host) {
  return RunScript(absl::StrCat("actuator ", robot, " ", host),
                   absl::StrCat("actuator/", robot, "/", host));
}

TlsFiles TestPki::Operator(absl::string_view role, absl::string_view name) {
  return RunScript(absl::StrCat("operator ", role, " ", name),
                   absl::StrCat("operator/", role, "/", name));
}

void TestPki::RenewServer(absl::string_view id) {
  RunScript(absl::StrCat("--renew server ", id), "server");
}

std::string TestPki::Revoke(const TlsFiles& files) {
  RunScript(absl::StrCat("revoke ", files.cert), "ca");
  return dir_ + "/crl.pem";
}

std::string TestPki::SignRevocations(int days) {
  RunScript(absl::StrCat("--days ", days, " crl"), "ca");
  return dir_ + "/crl.pem";
}

TlsFiles TestPki::Mint(const Special& special) {
  const TlsFiles files = FilesIn(special.folder);
  const std::string issuer = absl::StrCat(dir_, "/ca/", special.by_root ? "root" : "issuing");
  const std::string at = special.age_seconds == 0
                             ? ""
                             : absl::StrCat("faketime -f ", special.age_seconds > 0 ? "-" : "+",
                                            std::abs(special.age_seconds), "s ");
  const std::string san = special.san.empty() ? "" : "subjectAltName=" + special.san + "\\n";
  Run(absl::StrCat("set -e; mkdir ", dir_, "/", special.folder, "; cd ", dir_, "/", special.folder,
                   "; openssl ecparam -name prime256v1 -genkey -noout -out key.pem",
                   "; printf 'basicConstraints=CA:FALSE\\n", san, "' > ext",
                   "; openssl req -new -key key.pem -subj /CN=special -out csr", "; ", at,
                   "openssl x509 -req -in csr -CA ", issuer, ".pem -CAkey ", issuer,
                   ".key -set_serial 0x$(openssl rand -hex 15) -days ", special.days,
                   " -sha256 -extfile ext -out cert.pem 2>/dev/null"));
  if (!special.by_root) Run(absl::StrCat("cat ", issuer, ".pem >> ", files.cert));
  Run(absl::StrCat("cp ", dir_, "/ca.pem ", files.ca));
  return files;
}

}  // namespace rips::rpc
