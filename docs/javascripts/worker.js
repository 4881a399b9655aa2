// The search of a page opened from the disk. Browsers start no worker for a file:// page, so its script runs in a hidden
// frame instead, which talks to the page as a worker would. On a web server nothing of this is used.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super()
      this.frame = document.createElement("iframe")
      this.frame.hidden = true
      this.frame.answer = (data) => {
        const event = new MessageEvent("message", { data })
        this.dispatchEvent(event)
        if (this.onmessage) this.onmessage(event)
      }
      const load = "(...urls) => urls.forEach((url) => document.write('<script src=\"' + url + '\"></' + 'script>'))"
      const setup = `postMessage = (data) => frameElement.answer(data); importScripts = ${load}`
      this.frame.srcdoc = `<script>${setup}</script><script src="${url}"></script>`
      this.loaded = new Promise((resolve) => this.frame.addEventListener("load", resolve))
      document.body.append(this.frame)
    }

    postMessage(data) {
      this.loaded.then(() => this.frame.contentWindow.dispatchEvent(new MessageEvent("message", { data })))
    }

    terminate() {
      this.frame.remove()
    }
  }
}
